//! The pose of a calibrated camera from six 2D lines and the 3D points that project onto them.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Matrix6, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector6};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, PlaneLine, Point3};

use crate::quadrics::{intersect, quadric_of};

/// Three unit normals whose determinant is smaller than this lie in one plane: their lines meet in one point.
const FLAT_TRIPLE: f64 = 1e-9;

/// A pose must satisfy all six equations to this, in units of the sample's extent.
const RESIDUAL: f64 = 1e-7;

/// The 20 ways to choose three of six.
const TRIPLES: [[usize; 3]; 20] = triples();

/// Absolute camera pose from six line–point correspondences (calibrated, minimal).
///
/// A query line tells only that its map point projects *somewhere* on it: one equation per pair, six for the six
/// unknowns of the pose,
///
/// ```text
/// l_iᵀ (R X_i + t) = 0        i = 1..6,   (R, t) = cam_from_world
/// ```
///
/// # Input
/// - `lines[i]`: `l_i`, line on the z = 1 image plane (`l = Kᵀ l_pixel`), unit norm, either sign.
/// - `points[i]`: `X_i` in the world frame, map units. They are centred and scaled inside.
///
/// # Output
/// Appends 0 to 8 poses to `out`, as long as it has room, and returns how many. `R` is orthonormal to 1e-9, `t` is in
/// map units. The equations cannot tell front from back, so poses with any `X_i` at depth ≤ 0 are left out.
/// Order is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Lines through one common image point (parallel ones included) leave `t` free along that direction; a repeated
/// pair leaves one equation missing. Both give 0 poses, and RANSAC draws again. Up to **five** lines may share a
/// point: Dual Convergent Lines split 3+3, 4+2 or 5+1 over their two anchors are sound samples.
///
/// # Method and cost
/// Eliminates `t` through the best-conditioned of the 20 line triples, turns the world by a fixed rotation so that
/// no everyday pose sits on a special quaternion, intersects three quadrics in projective 3-space (`quadrics.rs`),
/// polishes each root by Newton's method there and once more on all six equations. No allocation, no randomness.
/// Runtime: see `benches/benches/solvers.rs`.
///
/// # Source
/// Speciale et al., *Privacy Preserving Image Queries for Camera Localization*, ICCV 2019 (the problem);
/// Kukelova et al., *Efficient Intersection of Three Quadrics*, CVPR 2016 (the solver).
///
/// # Example
/// ```
/// use veiloc_geometry::nalgebra::{Rotation3, Vector3};
/// use veiloc_geometry::{CameraFromWorld, PlaneLine, PlanePoint, Point3, Rigid3};
/// use veiloc_solvers::{ArrayVec, p6lp};
///
/// let truth: CameraFromWorld =
///     Rigid3::new(Rotation3::from_euler_angles(0.1, -0.4, 0.2), Vector3::new(0.3, -0.1, 4.0));
/// let points = [[1.0, 0.2, 0.1], [-0.8, 0.5, 0.9], [0.1, -0.9, 0.4], [0.6, 0.7, -0.8], [-0.5, -0.6, -0.3], [0.2, 0.3, 1.1]]
///     .map(|[x, y, z]| Point3::new(x, y, z));
/// let lines = std::array::from_fn(|i| {
///     let seen = PlanePoint::from_camera_point(&truth.transform(&points[i])).expect("in front");
///     let elsewhere = PlanePoint::new(seen.x + 1.0, seen.y + 0.7 * i as f64 - 2.0);
///     PlaneLine::joining(seen, elsewhere).expect("two points")
/// });
/// let mut poses = ArrayVec::new();
/// p6lp(&lines, &points, &mut poses);
/// assert!(poses.iter().any(|p| p.translation_error(&truth) < 1e-8));
/// ```
pub fn p6lp(
    lines: &[PlaneLine; 6],
    points: &[Point3<World>; 6],
    out: &mut ArrayVec<CameraFromWorld, 8>,
) -> usize {
    let n = lines.map(|l| *l.normal());
    let Some(frame) = SampleFrame::of(points) else { return 0 };
    let x: [Vector3<f64>; 6] = points.map(|p| frame.enter(&p.coords));

    let Some(best) = best_triple(&n) else { return 0 };
    let (chosen, others) = split(best);
    let base = Matrix3::from_rows(&chosen.map(|i| n[i].transpose()));
    let Some(base_inverse) = base.try_inverse() else { return 0 };

    // n_jᵀ = Σ_k c_k n_kᵀ over the chosen three, so t falls out of  n_jᵀ R X_j − Σ_k c_k n_kᵀ R X_k = 0.
    let forms = others.map(|j| {
        let c = n[j].transpose() * base_inverse;
        let mut m = n[j] * x[j].transpose();
        for (k, &i) in chosen.iter().enumerate() {
            m -= n[i] * x[i].transpose() * c[k];
        }
        quadric_of(&m)
    });
    let mut quaternions = ArrayVec::new();
    intersect(&forms, &mut quaternions);

    let mut appended = 0;
    for q in &quaternions {
        let r = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix();
        let f = Vector3::from_fn(|k, _| -n[chosen[k]].dot(&(r * x[chosen[k]])));
        let (mut r, mut t) = (r, base_inverse * f);
        newton_step(&n, &x, &mut r, &mut t);
        let sound = (0..6).all(|i| {
            let p = r * x[i] + t;
            p.z > 0.0 && n[i].dot(&p).abs() <= RESIDUAL * (1.0 + t.norm())
        });
        if sound {
            let pose = frame.leave(&r, &t);
            if !pose.is_finite() || out.try_push(pose).is_err() {
                continue;
            }
            appended += 1;
        }
    }
    appended
}

/// One Newton step on all six equations in the chart of [`CameraFromWorld::perturbed`], kept if it lowers them.
fn newton_step(n: &[Vector3<f64>; 6], x: &[Vector3<f64>; 6], r: &mut Rotation3<f64>, t: &mut Vector3<f64>) {
    let worst = |r: &Rotation3<f64>, t: &Vector3<f64>| {
        (0..6).map(|i| n[i].dot(&(r * x[i] + t)).abs()).fold(0.0_f64, f64::max)
    };
    let before = worst(r, t);
    if before < 1e-13 * (1.0 + t.norm()) {
        return;
    }
    let mut jacobian = Matrix6::zeros();
    let mut residual = Vector6::zeros();
    for i in 0..6 {
        let p = *r * x[i] + *t;
        residual[i] = n[i].dot(&p);
        let turn = p.cross(&n[i]);
        for k in 0..3 {
            jacobian[(i, k)] = turn[k];
            jacobian[(i, k + 3)] = n[i][k];
        }
    }
    let Some(step) = jacobian.lu().solve(&residual) else { return };
    if !(step.norm() < 0.1 * (1.0 + t.norm())) {
        return;
    }
    let turn = Rotation3::from_scaled_axis(-Vector3::new(step[0], step[1], step[2]));
    let moved = (turn * *r, turn * *t - Vector3::new(step[3], step[4], step[5]));
    if worst(&moved.0, &moved.1) < before {
        (*r, *t) = moved;
    }
}

/// The triple of normals that spans space best; `None` when all twenty are flat or a number is not finite.
fn best_triple(n: &[Vector3<f64>; 6]) -> Option<[usize; 3]> {
    let mut best = (FLAT_TRIPLE, None);
    for triple in TRIPLES {
        let det = n[triple[0]].cross(&n[triple[1]]).dot(&n[triple[2]]).abs();
        if det > best.0 {
            best = (det, Some(triple));
        }
    }
    best.1
}

fn split(chosen: [usize; 3]) -> ([usize; 3], [usize; 3]) {
    let mut others = [0; 3];
    let mut k = 0;
    for i in 0..6 {
        if !chosen.contains(&i) && k < 3 {
            others[k] = i;
            k += 1;
        }
    }
    (chosen, others)
}

const fn triples() -> [[usize; 3]; 20] {
    let mut out = [[0; 3]; 20];
    let mut count = 0;
    let mut a = 0;
    while a < 6 {
        let mut b = a + 1;
        while b < 6 {
            let mut c = b + 1;
            while c < 6 {
                out[count] = [a, b, c];
                count += 1;
                c += 1;
            }
            b += 1;
        }
        a += 1;
    }
    out
}

/// The sample's own frame: centred, of unit extent, and turned by a fixed rotation.
struct SampleFrame {
    center: Vector3<f64>,
    scale: f64,
    turn: Rotation3<f64>,
}

impl SampleFrame {
    fn of(points: &[Point3<World>; 6]) -> Option<Self> {
        let center = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 6.0;
        let extent = points.iter().map(|p| (p.coords - center).norm()).fold(0.0_f64, f64::max);
        // No axis, no angle of this rotation is special; identity and half-turns of real cameras become generic.
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.763, -1.127, 0.541));
        (extent.is_finite() && extent > 1e-12 * center.norm() && extent > 0.0 && center.norm().is_finite())
            .then_some(Self { center, scale: extent, turn })
    }

    fn enter(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.turn * ((x - self.center) / self.scale)
    }

    fn leave(&self, r: &Rotation3<f64>, t: &Vector3<f64>) -> CameraFromWorld {
        let rotation = r * self.turn;
        CameraFromWorld::new(rotation, t * self.scale - rotation * self.center)
    }
}
