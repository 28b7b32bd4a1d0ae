//! What an attacker who holds no position of the query has of it, and what he has of images he knows.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::DMatrix;

use crate::error::AttackError;

/// Descriptors of one image, as they are sent beside the lines.
#[derive(Debug, Clone, PartialEq)]
pub struct Descriptors {
    /// `[dimension, N]`: one unit column a keypoint; a column of zeros stays zero.
    columns: DMatrix<f32>,
}

impl Descriptors {
    /// From `[N · dimension]` row-major bytes.
    ///
    /// # Errors
    /// [`AttackError::Descriptors`] when the bytes are no whole number of descriptors.
    pub fn new(bytes: &[u8], dimension: usize) -> Result<Self, AttackError> {
        if dimension == 0 || !bytes.len().is_multiple_of(dimension) {
            return Err(AttackError::Descriptors { bytes: bytes.len(), dimension });
        }
        let values = bytes.iter().map(|b| f32::from(*b));
        let mut columns = DMatrix::from_iterator(dimension, bytes.len() / dimension, values);
        for mut column in columns.column_iter_mut() {
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        Ok(Self { columns })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.columns.ncols()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(crate) fn columns(&self) -> &DMatrix<f32> {
        &self.columns
    }

    /// Cosines with the descriptors of a query, `[own, query]`: those of one query descriptor are one column.
    pub(crate) fn cosines(&self, query: &Self) -> DMatrix<f32> {
        // Transposed beforehand: a plain product of matrices is blocked, one with a transpose is not.
        self.columns.transpose() * &query.columns
    }

    /// The columns with the image's mean taken off: what tells keypoints of one image apart.
    pub(crate) fn centered(&self) -> DMatrix<f32> {
        let mut columns = self.columns.clone();
        if !self.is_empty() {
            let mean = self.columns.column_mean();
            columns.column_iter_mut().for_each(|mut c| c -= &mean);
        }
        columns
    }
}

/// An image of which the attacker knows everything: one to learn from, or one of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownImage {
    keypoints: Vec<Pixel>,
    descriptors: Descriptors,
    size: [u32; 2],
}

impl KnownImage {
    /// Keypoints `[N]` in pixels, their descriptors, and the image's size in pixels.
    ///
    /// # Errors
    /// [`AttackError::DescriptorCount`] when there is not one descriptor per keypoint.
    pub fn new(
        keypoints: Vec<Pixel>,
        descriptors: Descriptors,
        width: u32,
        height: u32,
    ) -> Result<Self, AttackError> {
        if keypoints.len() != descriptors.len() {
            return Err(AttackError::DescriptorCount {
                keypoints: keypoints.len(),
                descriptors: descriptors.len(),
            });
        }
        Ok(Self { keypoints, descriptors, size: [width, height] })
    }

    /// Its descriptors.
    pub fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    pub(crate) fn keypoints(&self) -> &[Pixel] {
        &self.keypoints
    }

    /// A keypoint's place in an image of another size.
    pub(crate) fn scaled(&self, keypoint: usize, width: u32, height: u32) -> Pixel {
        let p = self.keypoints[keypoint];
        let scale = |x: f64, to: u32, from: u32| x * f64::from(to) / f64::from(from.max(1));
        Pixel::new(scale(p.u, width, self.size[0]), scale(p.v, height, self.size[1]))
    }
}
