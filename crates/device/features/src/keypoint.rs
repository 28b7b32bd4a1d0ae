//! Keypoints with their descriptors.

use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_geometry::Pixel;

use crate::Mask;

/// A point of an image that can be detected again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Its position in COLMAP's pixel convention, in the image it was extracted from (still distorted).
    pub pixel: Pixel,
    /// Standard deviation of the Gaussian at which it was found, pixels.
    pub scale: f32,
    /// Dominant gradient direction, radians from the `u` axis towards `v`, in (-π, π].
    pub orientation: f32,
    /// Strength by which keypoints are ranked; larger is stronger.
    pub response: f32,
}

/// Features of one image, strongest keypoint first.
#[derive(Clone, PartialEq)]
pub struct Features {
    /// `[N]`
    pub keypoints: Vec<Keypoint>,
    /// `[N, dim]`, row `i` belongs to keypoint `i`.
    pub descriptors: Descriptors,
    /// One vector of the whole image, if requested.
    pub global: Option<GlobalDescriptor>,
}

// Keypoint positions must never reach a log (rule L8).
impl std::fmt::Debug for Features {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Features({})", self.keypoints.len())
    }
}

impl Features {
    /// The features whose descriptor window lies within the image of `width` and `height` pixels: the disc of `support_radius`
    /// times the scale around the keypoint.
    ///
    /// `support_radius`: that of the extractor
    /// ([`Extractor::support_radius`](crate::Extractor::support_radius)).
    #[must_use]
    pub fn whole(self, (width, height): (u32, u32), support_radius: f64) -> Self {
        let inside = |at: f64, radius: f64, size: u32| at >= radius && at + radius <= f64::from(size);
        let whole = |keypoint: &Keypoint| {
            let radius = support_radius * f64::from(keypoint.scale);
            inside(keypoint.pixel.u, radius, width) && inside(keypoint.pixel.v, radius, height)
        };
        let kept: Vec<usize> = (0..self.keypoints.len()).filter(|&i| whole(&self.keypoints[i])).collect();
        Self {
            keypoints: kept.iter().map(|&i| self.keypoints[i]).collect(),
            descriptors: self.descriptors.select(kept),
            global: self.global,
        }
    }

    /// The features whose descriptor window does not touch a mask: the disc of `receptive_field` times the scale around the
    /// keypoint, plus a pixel. The mask may have the size of the image before it was scaled to `size`.
    #[must_use]
    pub(crate) fn clear_of(self, mask: &Mask, size: (u32, u32), receptive_field: f64) -> Self {
        let grown = [(mask.width(), size.0), (mask.height(), size.1)];
        let [columns, rows] = grown.map(|(file, own)| f64::from(file) / f64::from(own.max(1)));
        let clear = |keypoint: &Keypoint| {
            let radius = (receptive_field * f64::from(keypoint.scale) + 1.0) * columns.max(rows);
            !mask.touches(keypoint.pixel.u * columns, keypoint.pixel.v * rows, radius)
        };
        let kept: Vec<usize> = (0..self.keypoints.len()).filter(|&i| clear(&self.keypoints[i])).collect();
        Self {
            keypoints: kept.iter().map(|&i| self.keypoints[i]).collect(),
            descriptors: self.descriptors.select(kept),
            global: self.global,
        }
    }

    /// The first `most` features, which are the strongest.
    #[must_use]
    pub(crate) fn strongest(mut self, most: usize) -> Self {
        if self.keypoints.len() > most {
            self.keypoints.truncate(most);
            self.descriptors = self.descriptors.select(0..most);
        }
        self
    }

    /// The features with keypoints in an image of another size: `u` times `columns`, `v` times `rows`.
    ///
    /// For an image that was scaled down before extraction, with `columns = old width / new width`. Descriptors do not
    /// change.
    pub fn scaled(mut self, columns: f64, rows: f64) -> Self {
        for keypoint in &mut self.keypoints {
            keypoint.pixel = Pixel::new(keypoint.pixel.u * columns, keypoint.pixel.v * rows);
            keypoint.scale *= (columns * rows).sqrt() as f32;
        }
        self
    }
}
