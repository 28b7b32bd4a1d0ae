//! The pack: what a place looks like, without where.

use std::fmt;
use std::ops::Range;

use veiloc_descriptor::{DescriptorView, Descriptors, PointImage};

use crate::{PackId, Profile, QueryError, RowMatches};

/// The descriptors of a map's points, image by image, without positions: with it a device sends only what the place
/// knows, or matches by itself (`docs/guide/pack.md`).
///
/// It has no position of a point, a keypoint or a camera, and no name. It shows the textures of the place, and which
/// rows of its images are of one point.
#[derive(Clone, PartialEq)]
pub struct Pack {
    pub(crate) profile: Profile,
    pub(crate) points: u32,
    /// Rows of each image, one range after the other.
    pub(crate) images: Vec<Range<usize>>,
    /// Point of each row, `[N]`.
    pub(crate) point_of_row: Vec<u32>,
    /// `[N, dim]`
    pub(crate) descriptors: Descriptors,
    pub(crate) id: PackId,
}

/// An image of a pack.
#[derive(Debug, Clone, Copy)]
pub struct PackImage<'a> {
    descriptors: DescriptorView<'a>,
    points: &'a [u32],
}

impl<'a> PackImage<'a> {
    /// Point of each row, `[N]`, in rising order.
    pub const fn points(&self) -> &'a [u32] {
        self.points
    }
}

impl PointImage for PackImage<'_> {
    type Point = u32;

    fn descriptors(&self) -> DescriptorView<'_> {
        self.descriptors
    }

    fn point_of(&self, row: usize) -> Option<u32> {
        Some(self.points[row])
    }
}

impl Pack {
    /// Most rows of all images.
    pub const MAX_ROWS: usize = 1 << 22;

    /// `images`: of each, the points of its rows in rising order and the descriptors. Points are numbered from 0 and each
    /// is seen.
    ///
    /// The caller is responsible for an order of images and points that says nothing ([`MapFile::pack`] of the server).
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] for other images, descriptors of another kind than the profile's, no rows or more than
    /// [`Self::MAX_ROWS`].
    ///
    /// [`MapFile::pack`]: https://docs.rs/veiloc-map
    pub fn new(
        profile: Profile,
        points: u32,
        images: impl IntoIterator<Item = (Vec<u32>, Descriptors)>,
    ) -> Result<Self, QueryError> {
        let kind = profile.descriptor_kind();
        let (mut ranges, mut point_of_row, mut bytes) = (Vec::new(), Vec::new(), Vec::new());
        for (of_rows, descriptors) in images {
            if descriptors.kind() != kind || descriptors.len() != of_rows.len() {
                let (expected, actual) = (format!("{} of {kind}", of_rows.len()), format!("{descriptors:?}"));
                return Err(QueryError::Mismatch { what: "descriptors of an image", expected, actual });
            }
            let from = point_of_row.len();
            point_of_row.extend(of_rows);
            ranges.push(from..point_of_row.len());
            bytes.extend_from_slice(descriptors.as_decoded().as_bytes());
        }
        let descriptors = Descriptors::new(kind, bytes).expect("whole rows");
        let unchecked = Self {
            profile,
            points,
            images: ranges,
            point_of_row,
            descriptors,
            id: PackId::from_bytes([0; 16]),
        };
        unchecked.check()?;
        let id = unchecked.computed_id();
        Ok(Self { id, ..unchecked })
    }

    /// Whether rows, images and points fit together.
    pub(crate) fn check(&self) -> Result<(), QueryError> {
        let refuse = |what, expected: &str, actual: usize| {
            Err(QueryError::Mismatch { what, expected: expected.to_owned(), actual: actual.to_string() })
        };
        if self.point_of_row.is_empty() || self.point_of_row.len() > Self::MAX_ROWS {
            return refuse("rows of a pack", "from 1 to 4194304", self.point_of_row.len());
        }
        if self.points > RowMatches::MAX_POINTS {
            return refuse("points of a pack", "at most 16777216", self.points as usize);
        }
        for (image, range) in self.images.iter().enumerate() {
            if range.is_empty() || !self.point_of_row[range.clone()].is_sorted() {
                return refuse("points of an image", "some, in rising order", image);
            }
        }
        let mut is_seen = vec![false; self.points as usize];
        for point in &self.point_of_row {
            match is_seen.get_mut(*point as usize) {
                Some(seen) => *seen = true,
                None => return refuse("point of a row", "a point of the pack", *point as usize),
            }
        }
        match is_seen.iter().position(|seen| !seen) {
            Some(point) => refuse("points", "each in some image", point),
            None => Ok(()),
        }
    }

    /// The id, by which clients pin it.
    pub const fn id(&self) -> PackId {
        self.id
    }

    /// The profile of the map.
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Number of points.
    pub const fn point_count(&self) -> u32 {
        self.points
    }

    /// Number of images.
    pub const fn image_count(&self) -> usize {
        self.images.len()
    }

    /// Number of rows of all images.
    pub const fn row_count(&self) -> usize {
        self.point_of_row.len()
    }

    /// The image with this index, which must be below [`Self::image_count`].
    pub fn image(&self, index: usize) -> PackImage<'_> {
        let rows = self.images[index].clone();
        PackImage {
            descriptors: self.descriptors.view().rows(rows.clone()),
            points: &self.point_of_row[rows],
        }
    }

    /// The rows of an image, among [`Self::descriptors`].
    pub fn rows_of(&self, image: usize) -> Range<usize> {
        self.images[image].clone()
    }

    /// All rows, image by image, `[N, dim]`.
    pub fn descriptors(&self) -> DescriptorView<'_> {
        self.descriptors.view()
    }

    /// The point of each of them, `[N]`.
    pub fn points(&self) -> &[u32] {
        &self.point_of_row
    }
}

impl fmt::Debug for Pack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Pack({}, {} points, {} images)", self.id, self.points, self.images.len())
    }
}
