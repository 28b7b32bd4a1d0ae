//! Visibility: a descriptor is recognised from approximately the viewpoint of a map image, not from behind.
//!
//! A match means that a query descriptor resembles one of a map image. Descriptors stay similar over a limited change
//! of viewpoint: for SIFT few matches remain beyond 50° (Mikolajczyk and Schmid, *A performance evaluation of local
//! descriptors*, PAMI 2005, sec. 5), and right matches in four scenes were rotated by less than 40° in 99 of 100 cases
//! and changed in scale by less than 1.8. A pose that sees a point from behind, or from ten times the distance, cannot
//! be the cause of the match, whatever its residual. Poses that explain wrong matches by chance often have such
//! viewpoints, because the camera can move to where many points crowd together.

use veiloc_geometry::nalgebra::Vector3;

use crate::likelihood::problem::MatchViewpoint;

/// Rotation of the view up to which a match keeps its full probability, radians: 45°.
const FREE_TURN: f64 = std::f64::consts::FRAC_PI_4;

/// Beyond, it falls by `e^-½` per this angle, radians: 10°.
const TURN_FADE: f64 = 0.175;

/// Change of scale up to which a match keeps its full probability, natural logarithm: a factor of 3.
const FREE_SCALE: f64 = 1.1;

/// Beyond, it falls by `e^-½` per this change: a factor of 1.5.
const SCALE_FADE: f64 = 0.4;

/// Factor on the probability that a match is right, from the viewpoint of the camera, 0 to 1.
///
/// `center` is the camera's, `focal` its focal length in pixels.
pub(crate) fn visibility(
    point: &Vector3<f64>,
    seen_from: &MatchViewpoint,
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
        let then = MatchViewpoint { center: Point3::new(0.0, 0.0, -4.0), focal_px: 500.0 };
        visibility(&Vector3::zeros(), &then, &Vector3::from(center), 500.0)
    }

    #[test]
    fn visibility_is_one_near_the_map_image_and_zero_from_behind() {
        assert_eq!(seen([0.0, 0.0, -4.0]), 1.0);
        assert_eq!(seen([2.0, 1.0, -3.5]), 1.0);
        assert_eq!(seen([0.0, 0.0, -1.5]), 1.0);
        assert!(seen([0.0, 0.0, 4.0]) < 1e-9 && seen([4.0, 0.0, 0.0]) < 0.05);
        assert!(seen([0.0, 0.0, -40.0]) < 0.02 && seen([0.0, 0.0, -0.2]) < 1e-3);
        assert_eq!(seen([0.0; 3]), 0.0);
    }

    #[test]
    fn visibility_scales_with_focal_length() {
        let then = MatchViewpoint { center: Point3::new(0.0, 0.0, -1.0), focal_px: 500.0 };
        let at = |focal| visibility(&Vector3::zeros(), &then, &Vector3::new(0.0, 0.0, -8.0), focal);
        assert!(at(500.0) < 0.1);
        assert_eq!(at(4000.0), 1.0);
    }
}
