//! Which camera took an image, and where that is known from.

use serde::Serialize;
use veiloc_geometry::{CameraModel, Intrinsics};

/// Guessed focal length of an image that nothing is known of, over its longer side: COLMAP's guess, a lens that sees 45°
/// along that side. Telephones' main lenses see 55° to 70°.
const GUESSED_FOCAL: f64 = 1.2;

/// Where a camera comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraSource {
    /// It was given.
    Given,
    /// Nothing is known: no distortion, and a focal length of 1.2 times the longer side.
    Guess,
}

impl CameraSource {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Given, Self::Guess];

    /// As documents call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Guess => "guess",
        }
    }
}

/// The camera of an image of this size in pixels: the one that is given, or a guess.
pub(super) fn camera_of(given: Option<&Intrinsics>, size: (u32, u32)) -> (Intrinsics, CameraSource) {
    if let Some(camera) = given {
        return (*camera, CameraSource::Given);
    }
    let (width, height) = size;
    let [w, h] = [width, height].map(f64::from);
    let model = CameraModel::SimplePinhole([GUESSED_FOCAL * w.max(h), w / 2.0, h / 2.0]);
    (Intrinsics { model, width, height }, CameraSource::Guess)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_is_taken_and_the_rest_is_guessed() {
        let given: Intrinsics = "PINHOLE,640,480,500,510,320,240".parse().expect("a camera");
        assert_eq!(camera_of(Some(&given), (512, 341)), (given, CameraSource::Given));
        for size in [(512, 341), (341, 512)] {
            let (camera, source) = camera_of(None, size);
            assert_eq!((source, (camera.width, camera.height)), (CameraSource::Guess, size));
            let pinhole = camera.pinhole();
            assert!((pinhole.mean_focal() - 614.4).abs() < 1e-9, "{pinhole:?}");
            assert_eq!(pinhole.principal, [f64::from(size.0) / 2.0, f64::from(size.1) / 2.0]);
        }
    }
}
