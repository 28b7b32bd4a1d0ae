//! What a pose could have seen: a descriptor is recognised from about where a map image saw it, not from behind.
//!
//! A match says that a query descriptor looks like one of a map image. Descriptors stay alike over a limited change of
//! view: for SIFT little is matched beyond 50° (Mikolajczyk and Schmid, *A performance evaluation of local descriptors*,
//! PAMI 2005, sec. 5), and right matches of four places turned by less than 40° in 99 of 100 cases and changed in scale by
//! less than 1.8. A pose that sees a point from behind, or from ten times as far, cannot have been the reason of the
//! match, whatever its residual says; poses that explain wrong matches by chance do just that, because the camera is free
//! to go where many points crowd together.

use veiloc_geometry::nalgebra::Vector3;

use crate::likelihood::problem::SeenFrom;

/// Turn of the view up to which a match keeps its full worth, radians: 45°.
const FREE_TURN: f64 = std::f64::consts::FRAC_PI_4;

/// Over so much more it falls by `e^-½`, radians: 10°.
const TURN_FADE: f64 = 0.175;

/// Change of scale up to which a match keeps its full worth, natural logarithm: a factor of 3.
const FREE_SCALE: f64 = 1.1;

/// Over so much more it falls by `e^-½`: a factor of 1.5.
const SCALE_FADE: f64 = 0.4;

/// By how much the probability that a match is right falls because of where the camera sees the point from, 0 to 1.
///
/// `center` is the camera's, `focal` its focal length in pixels.
pub(crate) fn visibility(
    point: &Vector3<f64>,
    seen_from: &SeenFrom,
    center: &Vector3<f64>,
    focal: f64,
) -> f64 {
    let (now, then) = (point - center, point - seen_from.center.coords);
    let (near, far) = (now.norm(), then.norm());
    if !(near > 0.0 && far > 0.0) {
        return 0.0;
    }
    let turn = (now.dot(&then) / (near * far)).clamp(-1.0, 1.0).acos();
    let scale = ((near / focal) / (far / seen_from.focal_px)).ln().abs();
    let fade = |over: f64, width: f64| (over.max(0.0) / width).powi(2);
    (-0.5 * (fade(turn - FREE_TURN, TURN_FADE) + fade(scale - FREE_SCALE, SCALE_FADE))).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::Point3;

    fn seen(center: [f64; 3]) -> f64 {
        let then = SeenFrom { center: Point3::new(0.0, 0.0, -4.0), focal_px: 500.0 };
        visibility(&Vector3::zeros(), &then, &Vector3::from(center), 500.0)
    }

    #[test]
    fn near_the_map_image_everything_counts_and_from_behind_nothing() {
        assert_eq!(seen([0.0, 0.0, -4.0]), 1.0);
        assert_eq!(seen([2.0, 1.0, -3.5]), 1.0);
        assert_eq!(seen([0.0, 0.0, -1.5]), 1.0);
        assert!(seen([0.0, 0.0, 4.0]) < 1e-9 && seen([4.0, 0.0, 0.0]) < 0.05);
        assert!(seen([0.0, 0.0, -40.0]) < 0.02 && seen([0.0, 0.0, -0.2]) < 1e-3);
        assert_eq!(seen([0.0; 3]), 0.0);
    }

    #[test]
    fn a_longer_focal_length_sees_from_farther() {
        let then = SeenFrom { center: Point3::new(0.0, 0.0, -1.0), focal_px: 500.0 };
        let at = |focal| visibility(&Vector3::zeros(), &then, &Vector3::new(0.0, 0.0, -8.0), focal);
        assert!(at(500.0) < 0.1);
        assert_eq!(at(4000.0), 1.0);
    }
}
