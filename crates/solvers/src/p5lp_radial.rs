//! The pose of a camera up to its depth, from five half-lines that leave one image point.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, SMatrix, Vector2, Vector3};
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use crate::conics::{self, Conic};

/// A pose up to the translation along the optical axis, which a 1D radial camera cannot see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadialPose {
    /// World to the camera whose optical axis is the ray of the common image point.
    pub rotation: Rotation3<f64>,
    /// The two components of the translation across that axis, map units.
    pub offset: Vector2<f64>,
}

impl RadialPose {
    /// Where a point is across the optical axis: its image lies in this direction from the common image point.
    pub fn across(&self, point: &Point3<World>) -> Vector2<f64> {
        (self.rotation * point.coords).xy() + self.offset
    }
}

/// Pose of a 1D radial camera from five half-lines (calibrated, minimal).
///
/// All lines of one anchor of Dual Convergent Lines share the ray of the anchor. In the camera turned so that this ray
/// is the optical axis, each map point is known to lie in one direction from the principal point:
///
/// ```text
/// u_i ∥ (R X_i + t)_xy,   u_i · (R X_i + t)_xy > 0        i = 1..5,   unknown: R, t_x, t_y
/// ```
///
/// # Input
/// - `directions[i]`: `u_i`, direction of the half-line on the turned camera's image plane, any length.
/// - `points[i]`: `X_i` in the world frame, map units. They are centred and scaled inside.
///
/// # Output
/// Appends 0 to 4 poses to `out`, as long as it has room, and returns how many. All five points lie on their
/// half-lines; whether they are in front of the camera depends on the depth, which is not known yet.
/// Order is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Repeated pairs and points in one plane with the optical axis leave equations missing and give 0 poses or poor ones.
///
/// # Method and cost
/// Five equations linear in the first two rows of `(R | t)` leave a three-dimensional null space (Householder
/// reflections); that the two rows of `R` are perpendicular and of equal length makes two conics in it, which meet in
/// at most four points. No allocation, no randomness. Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// Kukelova, Bujnak and Pajdla, *Real-Time Solution to the Absolute Pose Problem with Unknown Radial Distortion and
/// Focal Length*, ICCV 2013; Larsson et al., *Calibration-Free Structure-from-Motion with Calibrated Radial
/// Trifocal Tensors*, ECCV 2020 (the name of the camera model).
pub fn p5lp_radial(
    directions: &[Vector2<f64>; 5],
    points: &[Point3<World>; 5],
    out: &mut ArrayVec<RadialPose, 4>,
) -> usize {
    let center = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 5.0;
    let scale = points.iter().map(|p| (p.coords - center).norm()).fold(0.0_f64, f64::max);
    let finite =
        directions.iter().all(|u| u.norm().is_finite() && u.norm() > 0.0) && center.norm().is_finite();
    if !(finite && scale.is_finite() && scale > 1e-12 * center.norm()) {
        return 0;
    }
    let x = points.map(|p| (p.coords - center) / scale);
    let u = directions.map(|u| u.normalize());
    // u × (P X) = 0 for the unknown rows P = (r1 t1; r2 t2), as a row of eight coefficients each.
    let equations = SMatrix::<f64, 5, 8>::from_fn(|i, j| {
        let (row, column) = (j / 4, j % 4);
        let coordinate = if column < 3 { x[i][column] } else { 1.0 };
        coordinate * if row == 0 { -u[i].y } else { u[i].x }
    });
    let Some(null) = null_space(&equations) else { return 0 };

    let rows = |k: usize| {
        let n = null.column(k);
        (Vector3::new(n[0], n[1], n[2]), Vector3::new(n[4], n[5], n[6]))
    };
    let basis = [rows(0), rows(1), rows(2)];
    let conic = |f: &dyn Fn(usize, usize) -> f64| Conic {
        xx: f(0, 0),
        xy: f(0, 1),
        xz: f(0, 2),
        yy: f(1, 1),
        yz: f(1, 2),
        zz: f(2, 2),
    };
    let perpendicular = conic(&|i, j| 0.5 * (basis[i].0.dot(&basis[j].1) + basis[j].0.dot(&basis[i].1)));
    let equal = conic(&|i, j| 0.5 * (basis[i].0.dot(&basis[j].0) - basis[i].1.dot(&basis[j].1)));

    let mut appended = 0;
    for weights in conics::intersect(&perpendicular, &equal) {
        if weights.sum().is_nan() {
            continue;
        }
        let weights = conics::polished(&perpendicular, &equal, &weights);
        let p = null * weights;
        let (r1, r2) = (Vector3::new(p[0], p[1], p[2]), Vector3::new(p[4], p[5], p[6]));
        let size = (0.5 * (r1.norm_squared() + r2.norm_squared())).sqrt();
        let exact = (r1.norm() - r2.norm()).abs() < 1e-6 * size && r1.dot(&r2).abs() < 1e-6 * size * size;
        if !(size > 1e-9 && exact) {
            continue;
        }
        // The sign that puts the first point on its half-line; all others must agree.
        let along = |i: usize| u[i].x * (r1.dot(&x[i]) + p[3]) + u[i].y * (r2.dot(&x[i]) + p[7]);
        let sign = along(0).signum() / size;
        if !(0..5).all(|i| sign * along(i) > 0.0) {
            continue;
        }
        let (e1, r2) = (r1.normalize() * sign.signum(), r2 * sign.signum());
        let e2 = (r2 - e1 * e1.dot(&r2)).normalize();
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&[
            e1.transpose(),
            e2.transpose(),
            e1.cross(&e2).transpose(),
        ]));
        let offset = Vector2::new(p[3], p[7]) * (sign * scale) - (rotation * center).xy();
        let pose = RadialPose { rotation, offset };
        let valid = pose.rotation.matrix().iter().chain(&pose.offset).all(|c| c.is_finite());
        if valid && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}

/// Three orthonormal vectors on which five equations in eight unknowns vanish; `None` when an equation is missing.
fn null_space(equations: &SMatrix<f64, 5, 8>) -> Option<SMatrix<f64, 8, 3>> {
    let mut a = equations.transpose();
    let mut mirrors = [[0.0; 8]; 5];
    for k in 0..5 {
        // The longest remaining column next, so that a missing equation shows as a short last one.
        let length = |c: usize| (k..8).map(|r| a[(r, c)] * a[(r, c)]).sum::<f64>();
        let longest = (k..5).max_by(|&i, &j| length(i).total_cmp(&length(j)))?;
        let norm = length(longest).sqrt();
        if !(norm > 1e-9) {
            return None;
        }
        a.swap_columns(k, longest);
        // Reflection that takes the column to (0.. , ∓norm, 0..).
        let mirror = &mut mirrors[k];
        for r in k..8 {
            mirror[r] = a[(r, k)];
        }
        mirror[k] += norm.copysign(mirror[k]);
        let size = (k..8).map(|r| mirror[r] * mirror[r]).sum::<f64>().sqrt();
        for m in mirror.iter_mut() {
            *m /= size;
        }
        for c in k..5 {
            let dot: f64 = (k..8).map(|r| mirror[r] * a[(r, c)]).sum();
            for r in k..8 {
                a[(r, c)] -= 2.0 * dot * mirror[r];
            }
        }
    }
    let mut null = SMatrix::<f64, 8, 3>::zeros();
    for c in 0..3 {
        null[(5 + c, c)] = 1.0;
        for mirror in mirrors.iter().rev() {
            let dot: f64 = (0..8).map(|r| mirror[r] * null[(r, c)]).sum();
            for r in 0..8 {
                null[(r, c)] -= 2.0 * dot * mirror[r];
            }
        }
    }
    Some(null)
}
