//! The pose of an upright camera from four 2D lines and the 3D points that project onto them.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, PlaneLine, Point3};

use crate::solvers::gravity::{GravityAlignment, angles_on_line};

/// When no three of the four normals span a larger volume than this, all lines meet in one point.
const FLAT: f64 = 1e-9;

/// When rotation about the vertical changes the equations by less than this, the angle is free.
const FREE_ANGLE: f64 = 1e-10;

/// Absolute camera pose from four line–point correspondences and a known vertical (calibrated, minimal).
///
/// ```text
/// l_iᵀ (R X_i + t) = 0        i = 1..4,   R down_in_world = down_in_camera,   (R, t) = cam_from_world
/// ```
///
/// # Input
/// - `lines[i]`: `l_i`, line on the z = 1 image plane (`l = Kᵀ l_pixel`), unit norm, either sign.
/// - `points[i]`: `X_i` in the world frame, map units. They are centred and scaled inside.
/// - `gravity`: the vertical in both frames.
///
/// # Output
/// Appends 0 to 2 poses to `out`, as long as it has space, and returns how many. `R` maps one vertical to the other
/// exactly, so an error of the vertical is an error of the pose. Poses with any `X_i` at depth ≤ 0 are dropped. Order
/// is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Lines through one common image point leave `t` free along its ray: four lines of one anchor of Dual Convergent Lines
/// (splits 3+1 and 2+2 are sound). A repeated pair, and points on one vertical line, leave the angle free. All give
/// 0 poses.
///
/// # Method and cost
/// The four normals are vectors of 3-space, so one combination `Σ λ_i l_i` of them vanishes, with `λ_i` the determinant
/// of the other three; the same combination of the equations has no `t` left and reads `a cos θ + b sin θ + d = 0`, a
/// line that meets the unit circle at most twice. `t` follows from the triple of largest determinant. Closed form,
/// no iteration, no allocation, no randomness. Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// The elimination is that of Speciale et al., *Privacy Preserving Image Queries for Camera Localization*, ICCV 2019
/// (`p4lp` with gravity, a quadratic in `tan θ/2`), here without a chart, so that no angle is special.
pub fn u4lp(
    lines: &[PlaneLine; 4],
    points: &[Point3<World>; 4],
    gravity: &GravityAlignment,
    out: &mut ArrayVec<CameraFromWorld, 2>,
) -> usize {
    let center = (points[0].coords + points[1].coords + points[2].coords + points[3].coords) * 0.25;
    let x: [Vector3<f64>; 4] = std::array::from_fn(|i| points[i].coords - center);
    let extent = x.iter().map(|x| x.norm_squared()).fold(0.0_f64, f64::max).sqrt();
    let n: [Vector3<f64>; 4] = std::array::from_fn(|i| *lines[i].normal());
    let (n01, n23) = (n[0].cross(&n[1]), n[2].cross(&n[3]));
    let lambda = [-n23.dot(&n[1]), n23.dot(&n[0]), -n01.dot(&n[3]), n01.dot(&n[2])];
    let omitted = (0..4).max_by(|&i, &j| lambda[i].abs().total_cmp(&lambda[j].abs())).unwrap_or(0);
    let largest = lambda[omitted].abs();
    if !(largest > FLAT && extent.is_finite() && extent > 1e-12 * center.norm()) {
        return 0;
    }

    let (mut a, mut b, mut d) = (0.0, 0.0, 0.0);
    for i in 0..4 {
        let (n, y) = (gravity.camera.tr_mul(&n[i]), gravity.world.tr_mul(&x[i]));
        a += lambda[i] * (n.x * y.x + n.y * y.y);
        b += lambda[i] * (n.y * y.x - n.x * y.y);
        d += lambda[i] * n.z * y.z;
    }
    if !(a.abs() + b.abs() > FREE_ANGLE * largest * extent) {
        return 0;
    }

    // t of the three best normals, by Cramer's rule: t = −Σ (n_i · R x_i) (n_j × n_k) / det.
    let [i, j, k] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]][omitted];
    let duals = [n[j].cross(&n[k]), n[k].cross(&n[i]), n[i].cross(&n[j])];
    let duals = Matrix3::from_columns(&duals) / -duals[0].dot(&n[i]);

    let mut appended = 0;
    for [cos, sin] in angles_on_line(a, b, d) {
        let r = gravity.rotation(cos, sin);
        let turned: [Vector3<f64>; 4] = std::array::from_fn(|i| r * x[i]);
        let t = duals * Vector3::new(n[i].dot(&turned[i]), n[j].dot(&turned[j]), n[k].dot(&turned[k]));
        // Without a solution for the angle all comparisons are with NaN and fail.
        if !turned.iter().all(|p| p.z + t.z > 0.0) {
            continue;
        }
        let pose = CameraFromWorld::new(r, t - r * center);
        if pose.is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}
