//! The pose of a calibrated camera from three points.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Point3};

use crate::solvers::conics::{self, Conic, largest};

/// Height of the triangle over its longest side, relative to that side, below which three points lie on a line.
const COLLINEAR: f64 = 1e-5;

/// A step of Newton's method shorter than this, in units of the longest side, is skipped.
const SMALL_STEP: f64 = 1e-11;

/// Squared ratio of depth to the triangle's height above which the rounding of the depths is visible in the rotation.
const FAR_OR_THIN: f64 = 1e4;

/// Squared ratio above which rounding has removed half of the digits of the rotation.
const HOPELESS: f64 = 1e10;

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
/// Appends 0 to 4 poses to `out`, as long as it has space, and returns how many; all have every point on the positive
/// side of its ray. Order is unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Collinear points, repeated rays, and triangles whose height is less than 1e-5 of their distance give 0 poses.
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
    let apart = |i: usize, j: usize| (points[i].coords - points[j].coords).norm_squared();
    let sides = [apart(1, 2), apart(2, 0), apart(0, 1)];
    let cosines =
        [bearings[1].dot(&bearings[2]), bearings[2].dot(&bearings[0]), bearings[0].dot(&bearings[1])];
    // The longest side is assigned to the last pair, so that neither conic below is close to zero.
    let first = largest(sides);
    let (second, third) = ([1, 2, 0][first], [2, 0, 1][first]);
    let order = [[0, 1, 2], [2, 0, 1], [1, 2, 0]][first];
    let longest = sides[first];
    if !(longest > 0.0 && longest.is_finite()) {
        return 0;
    }
    let x = points.map(|p| p.coords);
    let Some(world) = DualBasis::of(&x, longest) else { return 0 };
    let unit = 1.0 / longest;
    let triangle = Triangle {
        a12: sides[third] * unit,
        a13: sides[second] * unit,
        c12: cosines[third],
        c13: cosines[second],
        c23: cosines[first],
    };
    let scale = longest.sqrt();
    let height_squared = world.height_squared * unit;

    let mut appended = 0;
    triangle.depths(|depth| {
        // Back to the order of the points.
        let depths = depth * scale;
        let seen: [_; 3] = std::array::from_fn(|i| bearings[i] * depths[order[i]]);
        let mut r = world.rotation_to(&seen);
        let squared = depth.norm_squared();
        if squared > FAR_OR_THIN * height_squared {
            if squared > HOPELESS * height_squared {
                return;
            }
            r = orthonormal(&r);
        }
        let t = seen[0] - r * x[0];
        let pose = CameraFromWorld::new(Rotation3::from_matrix_unchecked(r), t);
        // The depths are finite, so the rotation is.
        if t.sum().is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    });
    appended
}

/// Squared sides of the triangle of map points, in units of the longest, and the cosines between their rays.
struct Triangle {
    a12: f64,
    a13: f64,
    c12: f64,
    c13: f64,
    c23: f64,
}

impl Triangle {
    /// Calls `visit` with the depths `λ` in units of the longest side, all positive: `λ_i² + λ_j² − 2 c_ij λ_i λ_j =
    /// a_ij` with `a_23 = 1`.
    #[inline]
    fn depths(&self, mut visit: impl FnMut(Vector3<f64>)) {
        let &Self { a12, a13, c12, c13, c23 } = self;
        let first = Conic { xx: 1.0, xy: -c12, xz: 0.0, yy: 1.0 - a12, yz: a12 * c23, zz: -a12 };
        let second = Conic { xx: 1.0, xy: 0.0, xz: -c13, yy: -a13, yz: a13 * c23, zz: 1.0 - a13 };
        // Solutions with positive depths are moved to the front without a branch, because they are unpredictable.
        let (mut positive, mut count) = ([Vector3::zeros(); 5], 0);
        for d in conics::intersect(&first, &second) {
            let size = d.y * d.y + d.z * (d.z - 2.0 * c23 * d.y);
            positive[count] = d * (1.0 / size.sqrt()).copysign(d.x);
            let same_side = usize::from(d.x * d.y > 0.0) & usize::from(d.x * d.z > 0.0);
            count += same_side & usize::from(size > 0.0);
        }
        for depth in &positive[..count] {
            if let Some(depth) = self.polished(*depth) {
                visit(depth);
            }
        }
    }

    fn residual(&self, d: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            d.x * (d.x - 2.0 * self.c12 * d.y) + d.y * d.y - self.a12,
            d.x * (d.x - 2.0 * self.c13 * d.z) + d.z * d.z - self.a13,
            d.y * (d.y - 2.0 * self.c23 * d.z) + d.z * d.z - 1.0,
        )
    }

    /// Newton's method on the three distances; `None` when it does not converge or a depth is not positive.
    fn polished(&self, mut depth: Vector3<f64>) -> Option<Vector3<f64>> {
        let mut now = self.residual(&depth);
        for _ in 0..5 {
            let size = now.norm_squared();
            // Half the Jacobian is (f1 f2 0; g1 0 g3; 0 h2 h3); Cramer's rule.
            let (f1, f2) = (depth.x - self.c12 * depth.y, depth.y - self.c12 * depth.x);
            let (g1, g3) = (depth.x - self.c13 * depth.z, depth.z - self.c13 * depth.x);
            let (h2, h3) = (depth.y - self.c23 * depth.z, depth.z - self.c23 * depth.y);
            let determinant = -2.0 * (f1 * g3 * h2 + f2 * g1 * h3);
            // The adjugate is about as large as the squared depths: is this step negligible?
            let squares = 1.0 + depth.norm_squared();
            if size * squares * squares < (SMALL_STEP * determinant) * (SMALL_STEP * determinant) {
                break;
            }
            let step = Vector3::new(
                f2 * (g3 * now.z - h3 * now.y) - g3 * h2 * now.x,
                f1 * (h3 * now.y - g3 * now.z) - g1 * h3 * now.x,
                h2 * (g1 * now.x - f1 * now.y) - f2 * g1 * now.z,
            );
            let step = step * (1.0 / determinant);
            let next = depth - step;
            if step.norm_squared() < 1e-15 {
                // The equations are quadratic: the remaining error is about the square of the step.
                return positive(next);
            }
            let then = self.residual(&next);
            if !(then.norm_squared() < size) {
                break;
            }
            (depth, now) = (next, then);
        }
        if now.norm_squared() < 1e-16 { positive(depth) } else { None }
    }
}

fn positive(depth: Vector3<f64>) -> Option<Vector3<f64>> {
    (depth.x > 0.0 && depth.y > 0.0 && depth.z > 0.0).then_some(depth)
}

/// The dual basis of two sides of a triangle and its normal, as rows.
struct DualBasis {
    rows: Matrix3<f64>,
    /// Squared height over the longest side.
    height_squared: f64,
}

impl DualBasis {
    /// `None` when the points lie on a line; `longest` is their longest side, squared.
    fn of(p: &[Vector3<f64>; 3], longest: f64) -> Option<Self> {
        let (along, other) = (p[2] - p[1], p[0] - p[1]);
        let normal = along.cross(&other);
        let area = normal.norm_squared();
        if !(area > COLLINEAR * COLLINEAR * longest * longest) {
            return None;
        }
        let inverse = 1.0 / area;
        let rows = [other.cross(&normal) * inverse, normal.cross(&along) * inverse, normal * inverse];
        let rows = Matrix3::from_rows(&rows.map(|r| r.transpose()));
        Some(Self { rows, height_squared: area / longest })
    }

    /// The linear map that takes the triangle to this one, congruent to it: a rotation.
    fn rotation_to(&self, p: &[Vector3<f64>; 3]) -> Matrix3<f64> {
        let (along, other) = (p[2] - p[1], p[0] - p[1]);
        Matrix3::from_columns(&[along, other, along.cross(&other)]) * self.rows
    }
}

/// The nearest rotation of a matrix that is a rotation up to rounding: its error is squared.
fn orthonormal(r: &Matrix3<f64>) -> Matrix3<f64> {
    r * (Matrix3::identity() * 1.5 - r.tr_mul(r) * 0.5)
}
