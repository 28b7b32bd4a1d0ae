//! Options of map building.

use veiloc_features::{Extractors, SharedGlobal};
use veiloc_map::BuildSettings;
use veiloc_protocol::ExtractionLimits;

/// Options of map building.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BuildOptions {
    /// Name of the local features. Default [`Extractors::DEFAULT`].
    pub features: String,
    /// Extractors by name. Default: the built-in ones, SIFT and compact.
    pub extractors: Extractors,
    /// Extractor of the global descriptors of whole images. Default: none; global descriptors are aggregated from the
    /// sent local ones with a trained vocabulary. With an extractor, devices refuse the map's profile unless their
    /// owners consent.
    pub global: Option<SharedGlobal>,
    /// Extraction limits of devices; published in the profile.
    pub device: ExtractionLimits,
    /// Settings for the map's own images; stored in the map, for images added later.
    pub settings: BuildSettings,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            features: Extractors::DEFAULT.to_owned(),
            extractors: Extractors::default(),
            global: None,
            device: ExtractionLimits::default(),
            settings: BuildSettings::default(),
        }
    }
}

/// Adapts the settings to the number of images: with two images a track has at most two observations.
pub(crate) fn for_images(settings: &BuildSettings, images: usize) -> BuildSettings {
    BuildSettings { min_track_length: settings.min_track_length.min(images as u32).max(2), ..*settings }
}

/// Lower bound of every pixel threshold, because keypoint noise does not shrink with the image. (Hold-out queries of
/// RedKitchen, 640 x 480, points: 0.31 cm with 3, 0.33 cm with 1.6; under dcl 0.42 cm and 0.52 cm. Given poses are
/// never exact either.)
const MIN_ERROR_PX: f64 = 3.0;

/// Scales a threshold for 1600 pixels to an image of this size.
pub(crate) fn pixels_at(threshold: f64, width: u32, height: u32) -> f64 {
    (threshold * f64::from(width.max(height)) / 1600.0).max(MIN_ERROR_PX)
}
