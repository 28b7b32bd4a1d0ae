//! Packs a compressed map.

use super::view::MapFile;
use crate::error::{MapError, ModelRecord};
use crate::model::MapModel;

impl MapModel {
    /// Halves the file of a compressed map, and changes the model to what that file represents: positions of points
    /// rounded to 24 bits, keypoints to a few hundredths of a pixel, covariances to a thousandth, global descriptors
    /// to the signs of their rotated codes, and descriptors packed as in messages, which is lossless for descriptors
    /// of 4 bits per dimension. Keypoints without a point are not supported.
    ///
    /// # Errors
    /// [`MapError::Model`]: the map is inconsistent, not compressed, or has a keypoint without a point.
    pub fn pack(&mut self) -> Result<(), MapError> {
        let refuse = |reason: &str| MapError::Model { record: ModelRecord::Map, reason: reason.to_owned() };
        if self.images.iter().flat_map(|i| &i.point_of_keypoint).any(Option::is_none) {
            return Err(refuse("has a keypoint that sees no point, which a packed map cannot store"));
        }
        let origin = origin_of(self.points.iter().map(|p| p.position.coords.into()));
        let compressed = self.compressed.as_mut();
        compressed.ok_or_else(|| refuse("is packed and not compressed"))?.packed_from = Some(origin);
        self.validate()?;
        *self = MapFile::unpacked_of(self)?.to_model();
        Ok(())
    }
}

/// The centre of the bounding box, rounded to a step at which adding a 24-bit number is exact.
fn origin_of(positions: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for position in positions {
        for axis in 0..3 {
            low[axis] = low[axis].min(position[axis]);
            high[axis] = high[axis].max(position[axis]);
        }
    }
    let extent = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    let step = if extent.is_normal() { extent.log2().ceil().exp2() } else { 1.0 };
    [0, 1, 2].map(|i| {
        let middle = (f64::midpoint(low[i], high[i]) / step).round() * step;
        // Removes the sign of zero.
        if middle.is_finite() { middle + 0.0 } else { 0.0 }
    })
}
