//! The pack of a map: its descriptors without positions.

use veiloc_descriptor::Descriptors;
use veiloc_protocol::{Pack, PackId, QueryError};

use crate::{MapFile, PointId};

/// Which points of a map the numbers of its pack are.
#[derive(Debug, Clone)]
pub struct PackPoints {
    id: PackId,
    /// `[points]`
    of_map: Vec<PointId>,
}

impl PackPoints {
    /// The pack.
    pub const fn id(&self) -> PackId {
        self.id
    }

    /// Number of points.
    pub const fn len(&self) -> usize {
        self.of_map.len()
    }

    /// Never true: a pack has points.
    pub const fn is_empty(&self) -> bool {
        self.of_map.is_empty()
    }

    /// The point with this number in the pack.
    pub fn point(&self, number: u32) -> Option<PointId> {
        self.of_map.get(number as usize).copied()
    }
}

impl MapFile {
    /// The pack of this map: all rows that observe points, without positions. The same map gives the same pack.
    ///
    /// Points are numbered in the order of their descriptors, and images come in the order of their points, so that no
    /// order says when or where an image was taken.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] for a map without points, and for one with more rows or points than a pack can have
    /// (give the pack of a region then).
    pub fn pack(&self) -> Result<(Pack, PackPoints), QueryError> {
        // The lowest row of each point decides its number.
        let mut lowest: Vec<Option<&[u8]>> = vec![None; self.point_count()];
        for image in self.images() {
            let descriptors = image.descriptors();
            for (row, point) in (0..descriptors.len()).filter_map(|row| Some((row, image.point_of(row)?))) {
                let (own, known) = (descriptors.row(row), &mut lowest[point.index()]);
                *known = Some(known.map_or(own, |known| known.min(own)));
            }
        }
        let mut of_map: Vec<PointId> = (0..self.point_count() as u32).map(PointId).collect();
        of_map.retain(|id| lowest[id.index()].is_some());
        of_map.sort_unstable_by_key(|id| (lowest[id.index()], *id));
        let mut number = vec![0; self.point_count()];
        (0_u32..).zip(&of_map).for_each(|(n, id)| number[id.index()] = n);

        let mut images: Vec<(Vec<u32>, Descriptors)> = Vec::with_capacity(self.image_count());
        for image in self.images() {
            let descriptors = image.descriptors();
            let linked =
                (0..descriptors.len()).filter_map(|row| Some((number[image.point_of(row)?.index()], row)));
            let mut rows: Vec<(u32, usize)> = linked.collect();
            rows.sort_unstable_by_key(|(point, row)| (*point, descriptors.row(*row)));
            if !rows.is_empty() {
                let selected = descriptors.to_owned().select(rows.iter().map(|(_, row)| *row));
                images.push((rows.into_iter().map(|(point, _)| point).collect(), selected));
            }
        }
        images.sort_unstable_by(|a, b| (&a.0, a.1.as_bytes()).cmp(&(&b.0, b.1.as_bytes())));
        let pack = Pack::new(self.profile().clone(), of_map.len() as u32, images)?;
        let points = PackPoints { id: pack.id(), of_map };
        // For `pack_points`; another thread may have been faster.
        let _ = self.pack.set(points.clone());
        Ok((pack, points))
    }

    /// The numbers of its pack, computed on first use.
    ///
    /// # Errors
    /// As [`Self::pack`].
    pub fn pack_points(&self) -> Result<&PackPoints, QueryError> {
        if let Some(known) = self.pack.get() {
            return Ok(known);
        }
        let (_, points) = self.pack()?;
        Ok(self.pack.get_or_init(|| points))
    }
}
