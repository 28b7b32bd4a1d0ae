//! What can be chosen when a map is built.

use veiloc_query::ExtractionLimits;

use crate::error::MappingError;

/// How to build a map.
///
/// Pixel thresholds are given for an image whose longer side has 1600 pixels, and scale with the image: noise of
/// poses and lenses does. None falls below [`Self::MIN_ERROR_PX`]: noise of keypoints does not.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BuildOptions {
    /// Keypoints of a map image, the strongest. Default 4096: a map may be richer than a query.
    pub max_keypoints: usize,
    /// Longest side at which map images are searched for keypoints, pixels. Default 1600.
    pub max_image_side: u32,
    /// What devices extract; published in the profile.
    pub device: ExtractionLimits,
    /// Words of the vocabulary. Default 64: more help little in places of up to some thousand images.
    pub vocabulary_words: usize,
    /// Images each image is matched with, at most (not counting those that chose it). Default 20.
    pub pairs_per_image: usize,
    /// Largest ratio of nearest to second-nearest descriptor distance of a match. Default 0.8, Lowe's.
    pub max_ratio: f32,
    /// Largest distance of a matched keypoint from its epipolar line, pixels at 1600. Default 4.
    pub max_epipolar_error_px: f64,
    /// Largest reprojection error of an observation, pixels at 1600. Default 4.
    pub max_reprojection_error_px: f64,
    /// Least angle between the two rays of a point that differ most, degrees. Default 1.5, COLMAP's.
    pub min_triangulation_angle_deg: f64,
    /// Least number of images that see a point. Default 3, as COLMAP has it: on two images agree too many wrong
    /// matches. (Hold-out queries of Herz-Jesu under dcl: 0.87 cm with 3, 1.24 cm with 2 and half as many hypotheses
    /// again.) A map of two images takes 2.
    pub min_track_length: usize,
    /// Seed of the vocabulary's training.
    pub seed: u64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            max_keypoints: 4096,
            max_image_side: 1600,
            device: ExtractionLimits::default(),
            vocabulary_words: 64,
            pairs_per_image: 20,
            max_ratio: 0.8,
            max_epipolar_error_px: 4.0,
            max_reprojection_error_px: 4.0,
            min_triangulation_angle_deg: 1.5,
            min_track_length: 3,
            seed: 0,
        }
    }
}

impl BuildOptions {
    /// No pixel threshold falls below this, however small the image. (Hold-out queries of RedKitchen, 640 x 480, points:
    /// 0.31 cm with 3, 0.33 cm with 1.6; under dcl 0.42 cm and 0.52 cm. Given poses are never exact either.)
    pub const MIN_ERROR_PX: f64 = 3.0;

    /// What is extracted from the map's images.
    pub(crate) const fn extraction(&self) -> ExtractionLimits {
        ExtractionLimits { max_keypoints: self.max_keypoints as u32, max_image_side: self.max_image_side }
    }

    /// A threshold given at 1600 pixels, for an image of this size.
    pub(crate) fn pixels_at(threshold: f64, width: u32, height: u32) -> f64 {
        (threshold * f64::from(width.max(height)) / 1600.0).max(Self::MIN_ERROR_PX)
    }

    /// Whether every option is in its range; the profile checks those it publishes.
    pub(crate) fn check(&self) -> Result<(), MappingError> {
        fn within<T: PartialOrd + std::fmt::Display>(
            option: &'static str,
            value: T,
            range: std::ops::RangeInclusive<T>,
            allowed: &'static str,
        ) -> Result<(), MappingError> {
            if range.contains(&value) {
                return Ok(());
            }
            Err(MappingError::Option { option, value: value.to_string(), allowed })
        }
        within("max_keypoints", self.max_keypoints, 1..=1_000_000, "a number from 1 to 1000000")?;
        within("max_image_side", self.max_image_side, 64..=100_000, "a number of pixels from 64 to 100000")?;
        within("vocabulary_words", self.vocabulary_words, 1..=512, "a number from 1 to 512")?;
        within("pairs_per_image", self.pairs_per_image, 1..=100_000, "a number from 1 to 100000")?;
        within("max_ratio", self.max_ratio, 0.1..=1.0, "a number from 0.1 to 1")?;
        let pixels = "a number of pixels from 0.1 to 100";
        within("max_epipolar_error_px", self.max_epipolar_error_px, 0.1..=100.0, pixels)?;
        within("max_reprojection_error_px", self.max_reprojection_error_px, 0.1..=100.0, pixels)?;
        let degrees = "a number of degrees from 0.01 to 60";
        within("min_triangulation_angle_deg", self.min_triangulation_angle_deg, 0.01..=60.0, degrees)?;
        within("min_track_length", self.min_track_length, 2..=100, "a number from 2 to 100")
    }
}
