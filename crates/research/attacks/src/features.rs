//! What an attacker who holds no position of the query has of it, and what he has of images he knows.

use veiloc_descriptor::DescriptorView;
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
    /// Those of a sealed query, of a map image or of an extractor, by the numbers their bytes stand for.
    pub fn of(rows: DescriptorView<'_>) -> Self {
        let values = (0..rows.len()).flat_map(|row| rows.values(row).map(f32::from));
        Self::from_values(rows.kind().dim(), rows.len(), values)
    }

    /// From `[N · dimension]` row-major bytes, each the number it is, as keypoint files hold them.
    ///
    /// # Errors
    /// [`AttackError::Descriptors`] when the bytes are no whole number of descriptors.
    pub fn new(bytes: &[u8], dimension: usize) -> Result<Self, AttackError> {
        if dimension == 0 || !bytes.len().is_multiple_of(dimension) {
            return Err(AttackError::Descriptors { bytes: bytes.len(), dimension });
        }
        let values = bytes.iter().map(|b| f32::from(*b));
        Ok(Self::from_values(dimension, bytes.len() / dimension, values))
    }

    fn from_values(dimension: usize, count: usize, values: impl Iterator<Item = f32>) -> Self {
        let mut columns = DMatrix::from_iterator(dimension, count, values);
        for mut column in columns.column_iter_mut() {
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        Self { columns }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.columns.ncols()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length of one.
    pub fn dimension(&self) -> usize {
        self.columns.nrows()
    }

    /// Some of them, in this order; all indices are of descriptors that there are.
    #[cfg(feature = "networks")]
    pub(crate) fn select(&self, which: &[usize]) -> Self {
        Self { columns: self.columns.select_columns(which) }
    }

    pub(crate) fn columns(&self) -> &DMatrix<f32> {
        &self.columns
    }

    /// Cosines with the descriptors of a query, `[own, query]`: those of one query descriptor are one column.
    pub(crate) fn cosines(&self, query: &Self) -> DMatrix<f32> {
        // Transposed beforehand: a plain product of matrices is blocked, one with a transpose is not.
        self.columns.transpose() * &query.columns
    }

    /// `[dimension, N]`: unit columns with the image's mean taken off, what tells keypoints of one image apart.
    pub fn centered(&self) -> DMatrix<f32> {
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

    /// Its keypoints `[N]`, pixels.
    pub fn keypoints(&self) -> &[Pixel] {
        &self.keypoints
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// A keypoint's place in an image of another size.
    pub(crate) fn scaled(&self, keypoint: usize, width: u32, height: u32) -> Pixel {
        let p = self.keypoints[keypoint];
        let scale = |x: f64, to: u32, from: u32| x * f64::from(to) / f64::from(from.max(1));
        Pixel::new(scale(p.u, width, self.size[0]), scale(p.v, height, self.size[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_of_signed_numbers_is_no_part_of_the_vector() {
        use veiloc_descriptor::{DescriptorKind, Encoding};
        let kind = DescriptorKind::new("own", 2, Encoding::Signed, 100).expect("a kind");
        let code = |x: f64| Encoding::Signed.byte(x);
        let bytes = [code(60.0), code(80.0), code(-60.0), code(-80.0), code(80.0), code(-60.0)];
        let own = Descriptors::of(DescriptorView::new(kind, &bytes).expect("whole rows"));
        let cosines = own.cosines(&own);
        assert!((cosines[(0, 1)] + 1.0).abs() < 1e-6, "opposite");
        assert!(cosines[(0, 2)].abs() < 1e-6, "at right angles");
    }
}
