//! Keypoints with their descriptors.

use veiloc_descriptor::Descriptors;
use veiloc_geometry::Pixel;

/// A place in an image that can be found again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Where, COLMAP's pixel convention, in the image it was extracted from (still distorted).
    pub pixel: Pixel,
    /// Standard deviation of the Gaussian at which it was found, pixels.
    pub scale: f32,
    /// Dominant gradient direction, radians from the `u` axis towards `v`, in (-π, π].
    pub orientation: f32,
    /// Strength by which keypoints are ranked; larger is stronger.
    pub response: f32,
}

/// What was extracted from one image, strongest keypoint first.
#[derive(Clone, PartialEq)]
pub struct Features {
    /// `[N]`
    pub keypoints: Vec<Keypoint>,
    /// `[N, dim]`, row `i` belongs to keypoint `i`.
    pub descriptors: Descriptors,
}

// Keypoint positions must never reach a log (leak L8).
impl std::fmt::Debug for Features {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Features({})", self.keypoints.len())
    }
}

impl Features {
    /// The same features with keypoints in an image of another size: `u` times `columns`, `v` times `rows`.
    ///
    /// For an image that was scaled down before extraction, with `columns = old width / new width`. Descriptors stay.
    pub fn scaled(mut self, columns: f64, rows: f64) -> Self {
        for keypoint in &mut self.keypoints {
            keypoint.pixel = Pixel::new(keypoint.pixel.u * columns, keypoint.pixel.v * rows);
            keypoint.scale *= (columns * rows).sqrt() as f32;
        }
        self
    }
}
