//! The pose of a calibrated camera from six 2D lines and the 3D points that project onto them.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, Vector3, Vector4};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, PlaneLine, Point3};

use crate::solvers::quadrics::{Quadric, intersect, polished};

/// Three unit normals whose determinant is smaller than this lie in one plane: their lines meet in one point.
const FLAT_TRIPLE: f64 = 1e-9;

/// A pose must satisfy all six equations to this, in units of the sample's extent.
const RESIDUAL: f64 = 1e-7;

/// Relative depth behind the camera from which polishing cannot bring a point in front.
const ROUGH: f64 = 1e-3;

/// The 20 ways to choose three of six, and what is left.
const TRIPLES: [([usize; 3], [usize; 3]); 20] = triples();

/// Absolute camera pose from six line–point correspondences (calibrated, minimal).
///
/// A query line means that its map point projects *somewhere* on it: one equation per pair, six for the six unknowns of
/// the pose,
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
/// Appends 0 to 8 poses to `out`, as long as it has space, and returns how many. `R` is orthonormal to 1e-9, `t` is in
/// map units. The equations cannot distinguish front from back, so poses with any `X_i` at depth ≤ 0 are dropped. Order
/// is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Lines through one common image point (parallel ones included) leave `t` free along that direction; a repeated
/// pair leaves one equation missing. Both give 0 poses, and RANSAC draws again. Up to **five** lines may share a
/// point: Dual Convergent Lines split 3+3, 4+2 or 5+1 over their two anchors are sound samples.
///
/// # Method and cost
/// Eliminates `t` through the best-conditioned of the 20 line triples, rotates the world by a fixed rotation so that
/// common poses do not have a special quaternion, intersects three quadrics in projective 3-space (`quadrics.rs`), and
/// polishes the roots that put the points in front of the camera by Newton's method. No allocation, no randomness.
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
/// use veiloc_pose::solvers::{ArrayVec, p6lp};
///
/// let truth: CameraFromWorld =
///     Rigid3::new(Rotation3::from_euler_angles(0.1, -0.4, 0.2), Vector3::new(0.3, -0.1, 4.0));
/// let points = [[1.0, 0.2, 0.1], [-0.8, 0.5, 0.9], [0.1, -0.9, 0.4], [0.6, 0.7, -0.8], [-0.5, -0.6, -0.3], [0.2, 0.3, 1.1]]
///     .map(|[x, y, z]| Point3::new(x, y, z));
/// let lines = std::array::from_fn(|i| {
///     let seen = PlanePoint::from_camera_point(&truth.transform(&points[i])).expect("in front");
///     let other = PlanePoint::new(seen.x + 1.0, seen.y + 0.7 * i as f64 - 2.0);
///     PlaneLine::joining(seen, other).expect("two points")
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
    let n: [Vector3<f64>; 6] = std::array::from_fn(|i| *lines[i].normal());
    let Some(frame) = SampleFrame::of(points) else { return 0 };
    let x: [Vector3<f64>; 6] = std::array::from_fn(|i| frame.enter(&points[i].coords));
    let Some(base) = Base::of(&n) else { return 0 };

    // n_jᵀ = Σ_k c_k n_kᵀ over the chosen three, so t falls out of  n_jᵀ R X_j − Σ_k c_k n_kᵀ R X_k = 0.
    let forms = base.others.map(|j| {
        let mut m = n[j] * x[j].transpose();
        for (dual, &i) in base.duals.iter().zip(&base.chosen) {
            m -= n[i] * (x[i] * n[j].dot(dual)).transpose();
        }
        Quadric::of(&m)
    });

    let mut appended = 0;
    intersect(&forms, |raw| {
        // Most solutions are behind the camera, which is known before their last digits are.
        let r = rotation_of(&raw);
        let t = base.translation(&r, &n, &x);
        let (ahead, reach) = (r.row(2).transpose(), -ROUGH * (1.0 + t.amax()));
        if !x.iter().all(|x| ahead.dot(x) + t.z > reach) {
            return;
        }
        let Some(q) = polished(&forms, &raw) else { return };
        let r = rotation_of(&q);
        let t = base.translation(&r, &n, &x);
        let tolerance = RESIDUAL * (1.0 + t.norm());
        let sound = (0..6).all(|i| {
            let p = r * x[i] + t;
            p.z > 0.0 && n[i].dot(&p).abs() <= tolerance
        });
        if sound {
            let pose = frame.leave(&r, &t);
            if pose.is_finite() && out.try_push(pose).is_ok() {
                appended += 1;
            }
        }
    });
    appended
}

/// The rotation of a unit quaternion `(w, x, y, z)`.
fn rotation_of(q: &Vector4<f64>) -> Matrix3<f64> {
    let [w, x, y, z] = [q[0], q[1], q[2], q[3]];
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, xz, yz, wx, wy, wz) = (x * y, x * z, y * z, w * x, w * y, w * z);
    Matrix3::new(
        1.0 - 2.0 * (yy + zz),
        2.0 * (xy - wz),
        2.0 * (xz + wy),
        2.0 * (xy + wz),
        1.0 - 2.0 * (xx + zz),
        2.0 * (yz - wx),
        2.0 * (xz - wy),
        2.0 * (yz + wx),
        1.0 - 2.0 * (xx + yy),
    )
}

/// The three lines through which the translation is eliminated.
struct Base {
    chosen: [usize; 3],
    others: [usize; 3],
    /// The dual basis of their normals: `t = Σ_k (n_kᵀ t) d_k`.
    duals: [Vector3<f64>; 3],
}

impl Base {
    /// The triple of normals that spans space best; `None` when all twenty are flat or a number is not finite.
    fn of(n: &[Vector3<f64>; 6]) -> Option<Self> {
        let (mut best, mut at) = (FLAT_TRIPLE, TRIPLES.len());
        let mut k = 0;
        for i in 0..4 {
            for j in i + 1..5 {
                let pair = n[i].cross(&n[j]);
                for third in &n[j + 1..] {
                    let det = pair.dot(third).abs();
                    at = if det > best { k } else { at };
                    best = if det > best { det } else { best };
                    k += 1;
                }
            }
        }
        let &(chosen, others) = TRIPLES.get(at)?;
        let [a, b, c] = chosen.map(|i| n[i]);
        let duals = [b.cross(&c), c.cross(&a), a.cross(&b)];
        let inverse = 1.0 / duals[0].dot(&a);
        Some(Self { chosen, others, duals: duals.map(|d| d * inverse) })
    }

    /// The translation that puts the three points on their lines.
    #[inline]
    fn translation(&self, r: &Matrix3<f64>, n: &[Vector3<f64>; 6], x: &[Vector3<f64>; 6]) -> Vector3<f64> {
        let mut t = Vector3::zeros();
        for (dual, &i) in self.duals.iter().zip(&self.chosen) {
            t -= dual * n[i].dot(&(r * x[i]));
        }
        t
    }
}

/// All ways to choose three of six, in rising order, each with the remaining three.
const fn triples() -> [([usize; 3], [usize; 3]); 20] {
    let mut out = [([0; 3], [0; 3]); 20];
    let mut count = 0;
    let mut a = 0;
    while a < 6 {
        let mut b = a + 1;
        while b < 6 {
            let mut c = b + 1;
            while c < 6 {
                let mut left = [0; 3];
                let (mut i, mut k) = (0, 0);
                while i < 6 {
                    if i != a && i != b && i != c {
                        left[k] = i;
                        k += 1;
                    }
                    i += 1;
                }
                out[count] = ([a, b, c], left);
                count += 1;
                c += 1;
            }
            b += 1;
        }
        a += 1;
    }
    out
}

/// The sample's own frame: centred, of unit extent, and rotated by a fixed rotation.
struct SampleFrame {
    center: Vector3<f64>,
    scale: f64,
    inverse_scale: f64,
}

/// The rotation about (0.763, −1.127, 0.541) by the length of that vector: neither its axis nor its angle is special,
/// so that identity and half-turns of real cameras become generic.
const TURN: Matrix3<f64> = Matrix3::new(
    0.34865667788953764,
    -0.7256955441280825,
    -0.5931310969723959,
    0.008921561332849826,
    0.6353826086675041,
    -0.7721459359125461,
    0.9372080487844817,
    0.26392218140111645,
    0.2280047268327146,
);

impl SampleFrame {
    fn of(points: &[Point3<World>; 6]) -> Option<Self> {
        let center = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) * (1.0 / 6.0);
        let extent = points
            .iter()
            .map(|p| (p.coords - center).norm_squared())
            .fold(0.0, |m: f64, d| if d > m || d.is_nan() { d } else { m });
        let finite = extent.is_finite() && extent > 1e-24 * center.norm_squared();
        let scale = extent.sqrt();
        (finite && scale > 0.0).then(|| Self { center, scale, inverse_scale: 1.0 / scale })
    }

    fn enter(&self, x: &Vector3<f64>) -> Vector3<f64> {
        TURN * ((x - self.center) * self.inverse_scale)
    }

    fn leave(&self, r: &Matrix3<f64>, t: &Vector3<f64>) -> CameraFromWorld {
        let rotation = r * TURN;
        CameraFromWorld::new(
            Rotation3::from_matrix_unchecked(rotation),
            t * self.scale - rotation * self.center,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fixed_turn_is_a_rotation() {
        let expected = Rotation3::from_scaled_axis(Vector3::new(0.763, -1.127, 0.541));
        assert!((TURN - expected.matrix()).norm() < 1e-15);
    }

    #[test]
    fn triples_and_complements_cover_all_six() {
        for (k, (chosen, others)) in TRIPLES.iter().enumerate() {
            let mut all: Vec<usize> = chosen.iter().chain(others).copied().collect();
            all.sort_unstable();
            assert_eq!(all, [0, 1, 2, 3, 4, 5]);
            assert!(TRIPLES[..k].iter().all(|t| t.0 < *chosen));
        }
    }
}
