//! Build settings of a map, as far as images added later need them.

use veiloc_protocol::ExtractionLimits;

use crate::error::MapError;

/// Build settings. Stored in the map file, and used again when images are added or removed.
///
/// Pixel thresholds refer to an image whose longer side has 1600 pixels, and scale with the image, as noise of poses
/// and intrinsics does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BuildSettings {
    /// Limits of feature extraction for map images. Default: the strongest 4096 keypoints, because a map may be
    /// richer than a query; 1600 pixels. (The limits for devices are in the profile.)
    pub extraction: ExtractionLimits,
    /// Words of the vocabulary. Default 64: more help little in scenes of up to some thousand images.
    pub vocabulary_words: u32,
    /// Maximum number of images with which each image is matched (not counting those that selected it). Default 20.
    pub pairs_per_image: u32,
    /// Minimum number of images that observe a point. Default 3, as in COLMAP: two images agree on too many wrong
    /// matches. (Hold-out queries of Herz-Jesu under dcl: 0.87 cm with 3, 1.24 cm with 2 and 1.5 times as many
    /// hypotheses.) A map of two images needs 2.
    pub min_track_length: u32,
    /// Maximum ratio of nearest to second-nearest descriptor distance of a match. Default 0.8, as in Lowe's paper.
    pub max_ratio: f32,
    /// Maximum distance of a matched keypoint from its epipolar line, pixels at 1600. Default 4.
    pub max_epipolar_error_px: f64,
    /// Maximum reprojection error of an observation, pixels at 1600. Default 4.
    pub max_reprojection_error_px: f64,
    /// Minimum of the largest angle between two rays of a point, degrees. Default 1.5, as in COLMAP.
    pub min_triangulation_angle_deg: f64,
    /// Seed of the vocabulary's training.
    pub seed: u64,
}

impl Default for BuildSettings {
    fn default() -> Self {
        Self {
            extraction: ExtractionLimits { max_keypoints: 4096, max_image_side: 1600 },
            vocabulary_words: 64,
            pairs_per_image: 20,
            min_track_length: 3,
            max_ratio: 0.8,
            max_epipolar_error_px: 4.0,
            max_reprojection_error_px: 4.0,
            min_triangulation_angle_deg: 1.5,
            seed: 0,
        }
    }
}

impl BuildSettings {
    /// Checks that every setting is in its range.
    ///
    /// # Errors
    /// [`MapError::Setting`] with the first one that is not.
    pub fn check(&self) -> Result<(), MapError> {
        fn within<T: PartialOrd + std::fmt::Display>(
            setting: &'static str,
            value: T,
            range: std::ops::RangeInclusive<T>,
            allowed: &'static str,
        ) -> Result<(), MapError> {
            // NaN is in no range.
            if range.contains(&value) {
                return Ok(());
            }
            Err(MapError::Setting { setting, value: value.to_string(), allowed })
        }
        let ExtractionLimits { max_keypoints, max_image_side } = self.extraction;
        within("max_keypoints", max_keypoints, 1..=1_000_000, "a number from 1 to 1000000")?;
        within("max_image_side", max_image_side, 64..=100_000, "a number of pixels from 64 to 100000")?;
        within("vocabulary_words", self.vocabulary_words, 1..=512, "a number from 1 to 512")?;
        within("pairs_per_image", self.pairs_per_image, 1..=100_000, "a number from 1 to 100000")?;
        within("min_track_length", self.min_track_length, 2..=100, "a number from 2 to 100")?;
        within("max_ratio", self.max_ratio, 0.1..=1.0, "a number from 0.1 to 1")?;
        let pixels = "a number of pixels from 0.1 to 100";
        within("max_epipolar_error_px", self.max_epipolar_error_px, 0.1..=100.0, pixels)?;
        within("max_reprojection_error_px", self.max_reprojection_error_px, 0.1..=100.0, pixels)?;
        let degrees = "a number of degrees from 0.01 to 60";
        within("min_triangulation_angle_deg", self.min_triangulation_angle_deg, 0.01..=60.0, degrees)
    }
}
