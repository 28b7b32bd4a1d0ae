//! Extractors: SIFT, and those that a program adds.

use std::path::Path;
use std::sync::Arc;

use veiloc_descriptor::DescriptorKind;

use crate::sift::extract_until;
use crate::{Border, FeatureError, Features, Image, SiftOptions};

/// Extracts features of one kind.
///
/// Only the detection and description of keypoints varies. Reading files, checking their size and scaling them down is
/// common to all, see [`extract_image`](crate::extract_image).
pub trait Extractor: Send + Sync {
    /// The kind of its descriptors; its name is the extractor's name.
    fn kind(&self) -> DescriptorKind;

    /// The `max_keypoints` strongest features of an image, strongest first, in the image's own pixels (COLMAP's
    /// convention: the centre of the first pixel is at (0.5, 0.5)).
    ///
    /// Equal images must give equal features, with any number of threads. An image without structure gives none.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] when it cannot run; [`FeatureError::Stopped`].
    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError>;

    /// Radius of a descriptor's window, as a multiple of the keypoint's scale.
    ///
    /// A descriptor whose window crosses the image's border shows the border, and so reveals the position of its
    /// keypoint: a device drops it ([`Features::whole`], rule L11 of docs/reference/privacy-rules.md). 0 keeps all features, and is
    /// correct only for descriptors that do not show the border.
    fn support_radius(&self) -> f64;

    /// Radius of a descriptor's window, as a multiple of the keypoint's scale, whether or not an image's border would
    /// show: keypoints whose window touches a mask are dropped. By default [`Self::support_radius`]. Networks also depend
    /// on pixels farther away, which under a mask are its continuation.
    fn receptive_field(&self) -> f64 {
        self.support_radius()
    }

    /// The source of precomputed features; `None`, the default, for extractors that compute them from the image.
    fn stored(&self) -> Option<&dyn FeatureStore> {
        None
    }
}

/// Precomputed features, stored by image name.
pub trait FeatureStore: Send + Sync {
    /// All features of the image in this file, of `size` pixels: strongest first, in pixels of the file.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] when the image has no stored features, or they are of an image of another size.
    fn features(&self, path: &Path, size: (u32, u32)) -> Result<Features, FeatureError>;

    /// The same features for images that are known together, by their names relative to a folder: a name in the store
    /// is then never taken for another image's. `None`, the default, if the store makes no difference.
    fn of_images(&self, folder: &Path, names: &[&str]) -> Option<Arc<dyn Extractor>> {
        let _ = (folder, names);
        None
    }
}

/// A shared extractor: a network is read once, for the map and for sealing.
impl<T: Extractor + ?Sized> Extractor for Arc<T> {
    fn kind(&self) -> DescriptorKind {
        (**self).kind()
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        (**self).extract(image, max_keypoints)
    }

    fn support_radius(&self) -> f64 {
        (**self).support_radius()
    }

    fn receptive_field(&self) -> f64 {
        (**self).receptive_field()
    }

    fn stored(&self) -> Option<&dyn FeatureStore> {
        (**self).stored()
    }
}

/// [`extract_sift`](crate::extract_sift) as an [`Extractor`].
#[derive(Debug, Clone, Default)]
pub struct Sift {
    /// How keypoints are found; the caller gives their number, not these options.
    pub options: SiftOptions,
}

impl Extractor for Sift {
    fn kind(&self) -> DescriptorKind {
        DescriptorKind::ROOT_SIFT
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let mut options = self.options.clone();
        options.max_keypoints = max_keypoints;
        extract_until(image.gray(), &options, image.stop()).ok_or(FeatureError::Stopped)
    }

    fn support_radius(&self) -> f64 {
        match self.options.border {
            Border::Cut => crate::sift::PATCH_RADIUS,
            Border::Mirrored => 0.0,
        }
    }

    fn receptive_field(&self) -> f64 {
        crate::sift::PATCH_RADIUS
    }
}

impl Sift {
    /// As a device describes features for sealing: the image's border does not show ([`Border::Mirrored`]).
    pub fn for_sealing() -> Self {
        Self { options: SiftOptions { border: Border::Mirrored, ..SiftOptions::default() } }
    }
}
