//! What makes features of an image: SIFT, and whatever else a program brings.

use std::path::Path;
use std::sync::Arc;

use veiloc_descriptor::DescriptorKind;

use crate::{Border, FeatureError, Features, Image, SiftOptions, extract_sift};

/// Makes features of one kind.
///
/// One axis varies: how keypoints are found and described. Reading files, checking their size and making them smaller
/// is the same for all, see [`extract_image`](crate::extract_image).
pub trait Extractor: Send + Sync {
    /// The kind of its descriptors; its name is the extractor's name.
    fn kind(&self) -> DescriptorKind;

    /// The `max_keypoints` strongest features of an image, strongest first, in the image's own pixels (COLMAP's
    /// convention: the centre of the first pixel is at (0.5, 0.5)).
    ///
    /// Equal images must give equal features, with any number of threads. An image without structure gives none.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] when it cannot run.
    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError>;

    /// How far from a keypoint its descriptor looks, as a multiple of the keypoint's scale.
    ///
    /// A descriptor that looks over the image's border shows that it does, and with that where its keypoint is: a device
    /// leaves it out ([`Features::whole`], rule L11 of docs/reference/privacy-rules.md). 0 keeps all, and is right only for descriptors
    /// that show nothing of the kind.
    fn reach(&self) -> f64;

    /// How far from a keypoint its descriptor looks, as a multiple of the keypoint's scale, whether or not an image's border
    /// would show: keypoints that look so under a mask are left out. That of [`Self::reach`] unless said otherwise.
    fn sight(&self) -> f64 {
        self.reach()
    }

    /// Features that were made before and are looked up; `None`, unless said otherwise, for what makes them of the image.
    fn stored(&self) -> Option<&dyn Stored> {
        None
    }
}

/// Features that were made elsewhere and are kept by the names of images.
pub trait Stored: Send + Sync {
    /// All features of the image in this file, of `size` pixels: strongest first, in pixels of the file.
    ///
    /// # Errors
    /// [`FeatureError::Extractor`] where there are none of it, or of an image of another size.
    fn features(&self, path: &Path, size: (u32, u32)) -> Result<Features, FeatureError>;
}

/// One that is shared: a network is read once, for the map and for what is sealed.
impl<T: Extractor + ?Sized> Extractor for Arc<T> {
    fn kind(&self) -> DescriptorKind {
        (**self).kind()
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        (**self).extract(image, max_keypoints)
    }

    fn reach(&self) -> f64 {
        (**self).reach()
    }

    fn sight(&self) -> f64 {
        (**self).sight()
    }

    fn stored(&self) -> Option<&dyn Stored> {
        (**self).stored()
    }
}

/// [`extract_sift`] as an [`Extractor`].
#[derive(Debug, Clone, Default)]
pub struct Sift {
    /// How keypoints are found; the number of them is the caller's, not these options'.
    pub options: SiftOptions,
}

impl Extractor for Sift {
    fn kind(&self) -> DescriptorKind {
        DescriptorKind::ROOT_SIFT
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let mut options = self.options.clone();
        options.max_keypoints = max_keypoints;
        Ok(extract_sift(image.gray(), &options))
    }

    fn reach(&self) -> f64 {
        match self.options.border {
            Border::Cut => crate::sift::REACH,
            Border::Mirrored => 0.0,
        }
    }

    fn sight(&self) -> f64 {
        crate::sift::REACH
    }
}

impl Sift {
    /// As a device describes what it sends: the image's border does not show ([`Border::Mirrored`]).
    pub fn for_sealing() -> Self {
        Self { options: SiftOptions { border: Border::Mirrored, ..SiftOptions::default() } }
    }
}
