//! What a device does with the pack of a place: it sends only rows that the place explains (rule L15), or the points that
//! it found by itself (rule L16).
//!
//! A row is *explained* when its nearest descriptor of the place is nearer, by a fixed ratio, than its nearest descriptor
//! of a background: 20,480 descriptors of photographs of anywhere, which are part of this library. A row that matches a
//! point of the view well may be a little farther. Ratios and background are the device's own, so no pack can change them.
//! A pack only ever removes rows of those that would be sent without one.

mod background;
mod fill;
mod find;
mod rows;
mod usage;

use std::sync::Arc;

use veiloc_descriptor::{Descriptors, SearchedRows};
use veiloc_protocol::Pack;

pub use find::ExplainedRow;
pub(crate) use rows::{PlaceRows, RowContent};
pub use usage::{PackUse, UnknownPackUse};

use crate::SealError;

/// A pack, prepared for sealing. Preparing costs about a millisecond per thousand rows; one serves any number of sealers.
#[derive(Clone)]
pub struct KnownPlace(Arc<Prepared>);

struct Prepared {
    pack: Pack,
    /// Compact descriptors of all rows.
    rows: SearchedRows,
    /// Images that see each point: those of point `i` end at `ends[i]`.
    ends: Vec<u32>,
    images: Vec<u32>,
}

impl KnownPlace {
    /// Prepares a pack.
    ///
    /// # Errors
    /// [`SealError::PackKind`] for descriptors to which the background cannot be compared; SIFT and compact ones can.
    pub fn new(pack: Pack) -> Result<Self, SealError> {
        let kind = pack.profile().descriptor_kind();
        let rows = background::comparable(&pack.descriptors().to_owned())
            .ok_or_else(|| SealError::PackKind { kind: kind.name().to_owned() })?;
        let mut of_points: Vec<Vec<u32>> = vec![Vec::new(); pack.point_count() as usize];
        for (image, number) in (0..pack.image_count()).zip(0_u32..) {
            for point in pack.image(image).points() {
                let images = &mut of_points[*point as usize];
                if images.last() != Some(&number) {
                    images.push(number);
                }
            }
        }
        let (mut ends, mut images) = (Vec::with_capacity(of_points.len()), Vec::new());
        for of_point in of_points {
            images.extend(of_point);
            ends.push(images.len() as u32);
        }
        Ok(Self(Arc::new(Prepared { pack, rows: SearchedRows::new(rows.view()), ends, images })))
    }

    /// The pack.
    pub fn pack(&self) -> &Pack {
        &self.0.pack
    }

    /// What the place says about each row of an image: what of it would be sent, and as which points.
    ///
    /// # Errors
    /// [`SealError::PackKind`] for another kind.
    pub fn look_up(&self, rows: &Descriptors) -> Result<Vec<ExplainedRow>, SealError> {
        Ok(self.found(rows)?.rows)
    }

    /// Images that see a point.
    fn images_of(&self, point: u32) -> &[u32] {
        let start = (point as usize).checked_sub(1).map_or(0, |before| self.0.ends[before]);
        &self.0.images[start as usize..self.0.ends[point as usize] as usize]
    }
}

impl PartialEq for KnownPlace {
    fn eq(&self, other: &Self) -> bool {
        self.pack().id() == other.pack().id()
    }
}

impl Eq for KnownPlace {}

impl std::fmt::Debug for KnownPlace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "KnownPlace({:?})", self.pack())
    }
}
