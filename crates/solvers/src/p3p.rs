//! The pose of a calibrated camera from three points.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Point3};

use crate::conics;

/// Absolute camera pose from three point correspondences (calibrated, minimal).
///
/// ```text
/// λ_i b_i = R X_i + t,   λ_i > 0        i = 1..3,   (R, t) = cam_from_world
/// ```
///
/// # Input
/// - `bearings[i]`: `b_i`, unit ray towards the keypoint in the camera frame.
/// - `points[i]`: `X_i` in the world frame, map units.
///
/// # Output
/// Appends 0 to 4 poses to `out`, as long as it has room, and returns how many; all have every point on the positive
/// side of its ray. Order is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Collinear points and repeated rays give 0 poses.
///
/// # Method and cost
/// The three squared distances between the points are quadratic forms in the depths `λ`; two differences of them are
/// conics in the plane of `λ` up to scale, which meet in at most four points (`conics.rs`). Depths are polished by
/// Newton's method on the three distances. No allocation, no randomness. Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// Persson and Nordberg, *Lambda Twist*, ECCV 2018, and Ding et al., *Revisiting the P3P Problem*, CVPR 2023 (the
/// pencil of conics and which of its members to split).
pub fn p3p(
    bearings: &[Vector3<f64>; 3],
    points: &[Point3<World>; 3],
    out: &mut ArrayVec<CameraFromWorld, 4>,
) -> usize {
    let x = points.map(|p| p.coords);
    let sides = [x[0] - x[1], x[0] - x[2], x[1] - x[2]];
    let scale = sides.iter().map(|s| s.norm()).fold(0.0_f64, f64::max);
    if !(scale.is_finite() && scale > 0.0 && bearings.iter().all(|b| b.iter().all(|c| c.is_finite()))) {
        return 0;
    }
    let a = sides.map(|s| s.norm_squared() / (scale * scale));
    let cosines =
        [bearings[0].dot(&bearings[1]), bearings[0].dot(&bearings[2]), bearings[1].dot(&bearings[2])];

    let mut depths: ArrayVec<Vector3<f64>, 4> = ArrayVec::new();
    solve_depths(&a, &cosines, &mut depths);
    let Some(world) = Triad::of(&x) else { return 0 };
    let mut appended = 0;
    for depth in depths {
        let seen = std::array::from_fn(|i| bearings[i] * (depth[i] * scale));
        let Some(camera) = Triad::of(&seen) else { continue };
        let r = Rotation3::from_matrix_unchecked(camera.axes * world.axes.transpose());
        let t = (seen[0] + seen[1] + seen[2] - r * (x[0] + x[1] + x[2])) / 3.0;
        let pose = CameraFromWorld::new(r, t);
        if pose.is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}

/// Pairs of rays, in the order of the distances `a` and the cosines: 12, 13, 23.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Depths with `λᵢ² + λⱼ² − 2 cᵢⱼ λᵢ λⱼ = aᵢⱼ`, all positive.
fn solve_depths(a: &[f64; 3], cosines: &[f64; 3], out: &mut ArrayVec<Vector3<f64>, 4>) {
    let forms: [Matrix3<f64>; 3] = std::array::from_fn(|k| {
        let (i, j) = PAIRS[k];
        let mut m = Matrix3::zeros();
        m[(i, i)] = 1.0;
        m[(j, j)] = 1.0;
        m[(i, j)] = -cosines[k];
        m[(j, i)] = -cosines[k];
        m
    });
    let whole = forms[0] + forms[1] + forms[2];
    let total = a[0] + a[1] + a[2];
    // The pair with the longest side takes part in both, so that neither conic is close to zero.
    let longest = (0..3).max_by(|&i, &j| a[i].total_cmp(&a[j])).unwrap_or(0);
    let [p, q] = [(longest + 1) % 3, (longest + 2) % 3];
    let first = forms[p] * a[longest] - forms[longest] * a[p];
    let second = forms[q] * a[longest] - forms[longest] * a[q];

    for direction in conics::intersect(&first, &second) {
        let size = direction.dot(&(whole * direction));
        let direction = if direction.sum() < 0.0 { -direction } else { direction };
        if !(size > 0.0) {
            continue;
        }
        let mut depth = direction * (total / size).sqrt();
        if polish(&forms, a, &mut depth) && depth.min() > 0.0 && !repeated(out, &depth) {
            // Two conics meet in four points: there is room.
            let _ = out.try_push(depth);
        }
    }
}

fn repeated(known: &ArrayVec<Vector3<f64>, 4>, depth: &Vector3<f64>) -> bool {
    known.iter().any(|k| (k - depth).norm() < 1e-10 * depth.norm())
}

/// Newton's method on the three distances; false when they are not met in the end.
fn polish(forms: &[Matrix3<f64>; 3], a: &[f64; 3], depth: &mut Vector3<f64>) -> bool {
    let residual = |d: &Vector3<f64>| Vector3::from_fn(|k, _| d.dot(&(forms[k] * d)) - a[k]);
    let mut now = residual(depth);
    for _ in 0..5 {
        if now.amax() < 1e-15 {
            break;
        }
        let jacobian = Matrix3::from_rows(&[
            2.0 * (forms[0] * *depth).transpose(),
            2.0 * (forms[1] * *depth).transpose(),
            2.0 * (forms[2] * *depth).transpose(),
        ]);
        let Some(inverse) = jacobian.try_inverse() else { break };
        let next = *depth - inverse * now;
        let then = residual(&next);
        if !(then.norm() < now.norm()) {
            break;
        }
        *depth = next;
        now = then;
    }
    now.amax() < 1e-8
}

/// An orthonormal frame carried by three points.
struct Triad {
    axes: Matrix3<f64>,
}

impl Triad {
    fn of(p: &[Vector3<f64>; 3]) -> Option<Self> {
        let along = p[1] - p[0];
        let normal = along.cross(&(p[2] - p[0]));
        let reach = along.norm() * (p[2] - p[0]).norm();
        if !(normal.norm() > 1e-10 * reach) {
            return None;
        }
        let (e1, e3) = (along.normalize(), normal.normalize());
        Some(Self { axes: Matrix3::from_columns(&[e1, e3.cross(&e1), e3]) })
    }
}
