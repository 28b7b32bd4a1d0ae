//! Where the camera of an image comes from: a calibration, the image's EXIF, or a guess, and what is said of it.

use std::path::Path;

use veiloc_features::{FeatureError, exif_camera, guessed_camera};
use veiloc_geometry::Intrinsics;
use veiloc_protocol::FocalKnowledge;

/// An image's camera, and how well its focal length is known: what [`SealOptions::with_focal`](crate::SealOptions) is to
/// be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownCamera {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// How well its focal length is known.
    pub focal: FocalKnowledge,
}

impl KnownCamera {
    /// One that was measured.
    pub const fn calibrated(intrinsics: Intrinsics) -> Self {
        Self { intrinsics, focal: FocalKnowledge::Calibrated }
    }

    /// The one that the image's EXIF tells the focal length of: a pinhole with its principal point in the middle. Nothing
    /// else of EXIF is looked at, and nothing of it enters the query but the focal length's place on the ladder.
    ///
    /// # Errors
    /// [`FeatureError::NoFocal`] when EXIF does not tell it, and others when the file is no image.
    pub fn from_exif(image: &Path) -> Result<Self, FeatureError> {
        Ok(Self { intrinsics: exif_camera(image)?, focal: FocalKnowledge::Exif })
    }

    /// A guess: 1.2 times the longer side. The server is told that it is one.
    ///
    /// # Errors
    /// [`FeatureError`] when the file is no image.
    pub fn guessed(image: &Path) -> Result<Self, FeatureError> {
        Ok(Self { intrinsics: guessed_camera(image)?, focal: FocalKnowledge::Unknown })
    }
}
