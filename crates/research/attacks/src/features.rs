//! What an attacker holds of a query without positions, and of images with known positions.

use veiloc_descriptor::DescriptorView;
use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::DMatrix;

use crate::error::AttackError;

/// Descriptors of one image, as they are sent with the lines.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedDescriptors {
    /// `[dimension, N]`: one unit column per keypoint; a zero column stays zero.
    columns: DMatrix<f32>,
}

impl DecodedDescriptors {
    /// Descriptors of a sealed query, a map image or an extractor, decoded from their bytes.
    pub fn of(rows: DescriptorView<'_>) -> Self {
        let values = (0..rows.len()).flat_map(|row| rows.values(row).map(f32::from));
        Self::from_values(rows.kind().dim(), rows.len(), values)
    }

    /// From `[N · dimension]` row-major bytes, one number from 0 to 255 per byte.
    ///
    /// # Errors
    /// [`AttackError::Descriptors`] when the number of bytes is not a multiple of `dimension`.
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

    /// Numbers that a network is given as they are in place of descriptors, `[N · dimension]` row-major; `dimension` may
    /// be 0.
    #[cfg(feature = "networks")]
    pub fn as_they_are(dimension: usize, count: usize, values: impl Iterator<Item = f32>) -> Self {
        // Networks get rows whose length is the root of the dimension.
        let scale = (dimension.max(1) as f32).sqrt();
        Self { columns: DMatrix::from_iterator(dimension, count, values.map(|value| value / scale)) }
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.columns.ncols()
    }

    /// True when there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length of one descriptor.
    pub fn dimension(&self) -> usize {
        self.columns.nrows()
    }

    /// The descriptors with these indices, in this order; all indices must be below `N`.
    #[cfg(feature = "networks")]
    pub(crate) fn select(&self, which: &[usize]) -> Self {
        Self { columns: self.columns.select_columns(which) }
    }

    pub(crate) fn columns(&self) -> &DMatrix<f32> {
        &self.columns
    }

    /// Cosines with the descriptors of a query, `[own, query]`: one column per query descriptor.
    pub(crate) fn cosines(&self, query: &Self) -> DMatrix<f32> {
        // Transposed beforehand: nalgebra blocks a plain matrix product, but not a product with a transpose.
        self.columns.transpose() * &query.columns
    }

    /// `[dimension, N]`: unit columns minus the mean of the image, which leaves what distinguishes keypoints of one
    /// image.
    pub fn centered(&self) -> DMatrix<f32> {
        let mut columns = self.columns.clone();
        if !self.is_empty() {
            let mean = self.columns.column_mean();
            columns.column_iter_mut().for_each(|mut c| c -= &mean);
        }
        columns
    }
}

/// An image whose keypoints and descriptors the attacker knows: a training image or an image of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownImage {
    keypoints: Vec<Pixel>,
    descriptors: DecodedDescriptors,
    size: [u32; 2],
}

impl KnownImage {
    /// Keypoints `[N]` in pixels, their descriptors, and the image's size in pixels.
    ///
    /// # Errors
    /// [`AttackError::DescriptorCount`] when the numbers of descriptors and keypoints differ.
    pub fn new(
        keypoints: Vec<Pixel>,
        descriptors: DecodedDescriptors,
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
    pub fn descriptors(&self) -> &DecodedDescriptors {
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

    /// The position of a keypoint, scaled to an image of another size.
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
    fn signed_encoding_offset_is_removed() {
        use veiloc_descriptor::{DescriptorKind, Encoding};
        let kind = DescriptorKind::new("own", 2, Encoding::Signed, 100).expect("a kind");
        let code = |x: f64| Encoding::Signed.byte(x);
        let bytes = [code(60.0), code(80.0), code(-60.0), code(-80.0), code(80.0), code(-60.0)];
        let own = DecodedDescriptors::of(DescriptorView::new(kind, &bytes).expect("whole rows"));
        let cosines = own.cosines(&own);
        assert!((cosines[(0, 1)] + 1.0).abs() < 1e-6, "opposite");
        assert!(cosines[(0, 2)].abs() < 1e-6, "at right angles");
    }
}
