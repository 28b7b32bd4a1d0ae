//! Where the camera of an image comes from: a calibration, the image's EXIF data, or a default focal length.

use std::path::Path;

use veiloc_features::{FeatureError, exif_camera, guessed_camera};
use veiloc_geometry::Intrinsics;
use veiloc_protocol::FocalKnowledge;

/// An image's camera, and how well its focal length is known: the query says so, and the server estimates a focal length
/// that is not calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownCamera {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// How well its focal length is known.
    pub focal: FocalKnowledge,
}

impl KnownCamera {
    /// A calibrated camera.
    pub const fn calibrated(intrinsics: Intrinsics) -> Self {
        Self { intrinsics, focal: FocalKnowledge::Calibrated }
    }

    /// The camera with the focal length of the image's EXIF data: a pinhole with its principal point in the middle. No
    /// other EXIF field is read, and only the rounded focal length enters the query.
    ///
    /// # Errors
    /// [`FeatureError::NoFocal`] when the EXIF data holds no focal length; other errors when the file is not an image.
    pub fn from_exif(image: &Path) -> Result<Self, FeatureError> {
        Ok(Self { intrinsics: exif_camera(image)?, focal: FocalKnowledge::Exif })
    }

    /// A default focal length: 1.2 times the longer side. The query marks it as such, so the server estimates it.
    ///
    /// # Errors
    /// [`FeatureError`] when the file is not an image.
    pub fn guessed(image: &Path) -> Result<Self, FeatureError> {
        Ok(Self { intrinsics: guessed_camera(image)?, focal: FocalKnowledge::Unknown })
    }
}

impl From<Intrinsics> for KnownCamera {
    fn from(intrinsics: Intrinsics) -> Self {
        Self::calibrated(intrinsics)
    }
}
