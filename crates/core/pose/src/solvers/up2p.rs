//! The pose of an upright camera from two points.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Point3};

use crate::solvers::gravity::{GravityAlignment, angles_on_line};

/// Rays closer than this (sine of their angle) are one ray.
const ONE_RAY: f64 = 1e-10;

/// When rotation about the vertical changes the equation by less than this, the angle is free.
const FREE_ANGLE: f64 = 1e-10;

/// Absolute camera pose from two point correspondences and a known vertical (calibrated, minimal).
///
/// ```text
/// λ_i b_i = R X_i + t,   λ_i > 0        i = 1, 2,   R down_in_world = down_in_camera,   (R, t) = cam_from_world
/// ```
///
/// Two points give four equations for the four unknowns `θ` and `t`.
///
/// # Input
/// - `bearings[i]`: `b_i`, unit ray towards the keypoint in the camera frame.
/// - `points[i]`: `X_i` in the world frame, map units.
/// - `gravity`: the vertical in both frames.
///
/// # Output
/// Appends 0 to 2 poses to `out`, as long as it has space, and returns how many; all have both points on the positive
/// side of their rays, and `R` maps one vertical to the other exactly. Order is unspecified but the same for the same
/// input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Equal rays, equal points, and two points on one vertical line give 0 poses.
///
/// # Method and cost
/// The two points lie in the plane of the two rays: `(b_1 × b_2)ᵀ R (X_1 − X_2) = 0` has no `t` and no depth left and
/// reads `a cos θ + b sin θ + d = 0`, a line that meets the unit circle at most twice. The depths follow linearly.
/// Closed form, no iteration, no allocation, no randomness. Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// Kukelova, Bujnak and Pajdla, *Closed-Form Solutions to Minimal Absolute Pose Problems with Known Vertical
/// Direction*, ACCV 2010, here without the chart `tan θ/2`, so that no angle is special.
pub fn up2p(
    bearings: &[Vector3<f64>; 2],
    points: &[Point3<World>; 2],
    gravity: &GravityAlignment,
    out: &mut ArrayVec<CameraFromWorld, 2>,
) -> usize {
    let [b1, b2] = bearings;
    let apart = points[0].coords - points[1].coords;
    let distance = apart.norm();
    let normal = b1.cross(b2);
    let sine = normal.norm();
    if !(sine > ONE_RAY && sine.is_finite() && distance > 0.0 && distance.is_finite()) {
        return 0;
    }
    let (n, y) = (gravity.camera.tr_mul(&normal), gravity.world.tr_mul(&apart));
    let (a, b, d) = (n.x * y.x + n.y * y.y, n.y * y.x - n.x * y.y, n.z * y.z);
    if !(a.abs() + b.abs() > FREE_ANGLE * sine * distance) {
        return 0;
    }

    let middle = (points[0].coords + points[1].coords) * 0.5;
    let mut appended = 0;
    for [cos, sin] in angles_on_line(a, b, d) {
        let r = gravity.rotation(cos, sin);
        // λ1 b1 − λ2 b2 = v, crossed with either ray and projected onto the normal.
        let v = r * apart;
        let depths = [v.cross(b2).dot(&normal), v.cross(b1).dot(&normal)].map(|l| l / (sine * sine));
        // Without a solution for the angle, depths are NaN, and comparisons with NaN fail.
        if !(depths[0] > 0.0 && depths[1] > 0.0) {
            continue;
        }
        let pose = CameraFromWorld::new(r, (b1 * depths[0] + b2 * depths[1]) * 0.5 - r * middle);
        if pose.is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}
