//! What can be chosen when a map is built.

use veiloc_features::{Extractors, SharedGlobal};
use veiloc_map::BuildSettings;
use veiloc_protocol::ExtractionLimits;

/// How to build a map.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BuildOptions {
    /// Name of what makes the features. Default [`Extractors::DEFAULT`].
    pub features: String,
    /// What makes features, by name. Default: the built-in ones, SIFT and compact.
    pub extractors: Extractors,
    /// What makes the global descriptors, of each image as a whole. Default: none; they are summed up from the descriptors that
    /// are sent, by a vocabulary that is learned. With one, devices refuse the map's profile unless their owners consent.
    pub global: Option<SharedGlobal>,
    /// What devices extract; published in the profile.
    pub device: ExtractionLimits,
    /// What is done with the map's own images; kept in the map, for images that join later.
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

/// For a map of so many images: on two images, a point can be seen by two.
pub(crate) fn for_images(settings: &BuildSettings, images: usize) -> BuildSettings {
    BuildSettings { min_track_length: settings.min_track_length.min(images as u32).max(2), ..*settings }
}

/// No pixel threshold falls below this, however small the image: noise of keypoints does not. (Hold-out queries of
/// RedKitchen, 640 x 480, points: 0.31 cm with 3, 0.33 cm with 1.6; under dcl 0.42 cm and 0.52 cm. Given poses are never
/// exact either.)
const MIN_ERROR_PX: f64 = 3.0;

/// A threshold given at 1600 pixels, for an image of this size.
pub(crate) fn pixels_at(threshold: f64, width: u32, height: u32) -> f64 {
    (threshold * f64::from(width.max(height)) / 1600.0).max(MIN_ERROR_PX)
}
