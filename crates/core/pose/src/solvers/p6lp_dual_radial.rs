//! The pose of a calibrated camera from five half-planes of one anchor and one of another.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Point3};

use crate::solvers::half_plane::HalfPlane;
use crate::solvers::p5lp_radial::p5lp_radial;

/// Sine of the angle between the first anchor's ray and the sixth line's plane below which the depth is free.
const FREE_DEPTH: f64 = 1e-9;

/// Absolute camera pose from six half-planes, five of which begin at one axis (calibrated, minimal).
///
/// The five observe a 1D radial camera about the ray `a` of their anchor, which determines everything but the depth `τ`
/// along that ray; the sixth, of another anchor, determines the depth:
///
/// ```text
/// (R, t_0) from the five,   t = t_0 + τ a,   l_6ᵀ (R X_6 + t_0 + τ a) = 0        (R, t) = cam_from_world
/// ```
///
/// # Input
/// - `anchor`: `a`, the direction at which the five begin, in the camera frame, any length: ahead, beside or behind.
/// - `inward[i]`: where the half-plane of `points[i]` leads from there, in the camera frame, any length.
/// - `sixth`: the half-plane of `points[5]`, with its own axis.
/// - `points[i]`: `X_i` in the world frame, map units. They are centred and scaled inside.
///
/// # Output
/// Appends 0 to 4 poses to `out`, as long as it has space, and returns how many. All six points are in front of the
/// camera and in their half-planes. Order is unspecified but the same for the same input. Never panics; non-finite
/// input gives 0 poses.
///
/// # Degenerate samples
/// Those of [`p5lp_radial`], and a sixth line through the first anchor (the dividing line of Dual Convergent Lines is
/// one): 0 poses.
///
/// # Method and cost
/// [`p5lp_radial`] in the camera rotated so that `a` is its optical axis, then one division per pose. No polynomial of
/// degree eight is solved, and wrong hypotheses rarely survive six half-plane tests, so this is cheaper than `p6lp`
/// both here and in the scoring that follows. No allocation, no randomness. Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// The radial camera: Kukelova, Bujnak and Pajdla, ICCV 2013 (see [`p5lp_radial`]). The lines of Dual Convergent Lines
/// as two radial cameras: this project.
pub fn p6lp_dual_radial(
    anchor: &Vector3<f64>,
    inward: &[Vector3<f64>; 5],
    sixth: &HalfPlane,
    points: &[Point3<World>; 6],
    out: &mut ArrayVec<CameraFromWorld, 4>,
) -> usize {
    let Some(axes) = axes_about(anchor) else { return 0 };
    let normal = sixth.normal();
    let along = axes.column(2);
    let slope = normal.dot(&along);
    if !(slope.abs() > FREE_DEPTH * normal.norm()) {
        return 0;
    }
    // Seen in the turned camera, across its optical axis.
    let turned: [Vector2<f64>; 5] =
        std::array::from_fn(|i| Vector2::new(axes.column(0).dot(&inward[i]), axes.column(1).dot(&inward[i])));
    let [x1, x2, x3, x4, x5, last] = *points;
    let mut radial = ArrayVec::new();
    p5lp_radial(&turned, &[x1, x2, x3, x4, x5], &mut radial);

    let mut appended = 0;
    for pose in radial {
        let rotation = Rotation3::from_matrix_unchecked(axes * pose.rotation.matrix());
        let across = axes.column(0) * pose.offset.x + axes.column(1) * pose.offset.y;
        let seen = rotation * last.coords + across;
        let translation: Vector3<f64> = across - along * (normal.dot(&seen) / slope);
        // `p5lp_radial` has put the five on their lines, on the right half if they are in front of the camera.
        let in_front = points[..5].iter().all(|x| (rotation * x.coords + translation).z > 0.0);
        if !(in_front && sixth.contains(&(rotation * last.coords + translation))) {
            continue;
        }
        let pose = CameraFromWorld::new(rotation, translation);
        if pose.is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}

/// Axes of the camera turned so that a direction, or its opposite, is its optical axis, as columns seen in the camera.
fn axes_about(direction: &Vector3<f64>) -> Option<Matrix3<f64>> {
    // An axis has no sign; it is chosen forward, so that no division by zero occurs.
    let ahead = if direction.z < 0.0 { -direction } else { *direction };
    let z = ahead / ahead.norm();
    // The least turn from (0, 0, 1), by Rodrigues' formula written out.
    let k = 1.0 / (1.0 + z.z);
    let axes = Matrix3::new(
        1.0 - z.x * z.x * k,
        -z.x * z.y * k,
        z.x,
        -z.x * z.y * k,
        1.0 - z.y * z.y * k,
        z.y,
        -z.x,
        -z.y,
        z.z,
    );
    axes.iter().all(|c| c.is_finite()).then_some(axes)
}
