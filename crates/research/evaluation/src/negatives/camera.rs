//! The camera of an image, and its source.

use std::path::Path;

use serde::Serialize;
use veiloc_features::FeatureError;
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::KnownCamera;

/// Source of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum CameraSource {
    /// The camera was given, and is treated as calibrated.
    Given,
    /// The image's EXIF metadata has its focal length.
    Exif,
    /// The camera is unknown, and the queries say so: no distortion, and a focal length of 1.2 times the longer side.
    Assumed,
}

impl CameraSource {
    /// All sources.
    pub const ALL: [Self; 3] = [Self::Given, Self::Exif, Self::Assumed];

    /// Name in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Exif => "exif",
            Self::Assumed => "assumed",
        }
    }
}

/// The camera of an image: the given one, that of its EXIF metadata, or an assumed one.
pub(super) fn camera_of(
    given: Option<&Intrinsics>,
    image: &Path,
) -> Result<(KnownCamera, CameraSource), FeatureError> {
    if let Some(camera) = given {
        return Ok((KnownCamera::calibrated(*camera), CameraSource::Given));
    }
    match KnownCamera::from_exif(image) {
        Ok(camera) => Ok((camera, CameraSource::Exif)),
        Err(FeatureError::NoFocal { .. }) => Ok((KnownCamera::guessed(image)?, CameraSource::Assumed)),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_protocol::FocalKnowledge;

    #[test]
    fn given_camera_is_used_and_invalid_files_are_refused() {
        let given: Intrinsics = "PINHOLE,640,480,500,510,320,240".parse().expect("a camera");
        let nowhere = Path::new("nowhere.jpg");
        let (camera, source) = camera_of(Some(&given), nowhere).expect("given");
        assert_eq!((camera.intrinsics, camera.focal), (given, FocalKnowledge::Calibrated));
        assert_eq!(source, CameraSource::Given);
        assert!(camera_of(None, nowhere).is_err());
    }
}
