//! The pose of a camera up to its depth, from five half-lines that leave one image point.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use crate::solvers::conics::{self, Conic};

/// Sine of an angle below which directions are parallel.
const PARALLEL: f64 = 1e-9;

/// A coefficient smaller than this, relative to the extent of the points, counts as zero.
const MISSING: f64 = 1e-9;

/// Tolerance for rows of a rotation that need no polishing.
const EXACT: f64 = 1e-13;

/// Tolerance for rows of a rotation after polishing.
const SOUND: f64 = 1e-7;

/// All ways to choose two of five, in rising order, each with the remaining three.
const PAIRS: [([usize; 2], [usize; 3]); 10] = [
    ([0, 1], [2, 3, 4]),
    ([0, 2], [1, 3, 4]),
    ([0, 3], [1, 2, 4]),
    ([0, 4], [1, 2, 3]),
    ([1, 2], [0, 3, 4]),
    ([1, 3], [0, 2, 4]),
    ([1, 4], [0, 2, 3]),
    ([2, 3], [0, 1, 4]),
    ([2, 4], [0, 1, 3]),
    ([3, 4], [0, 1, 2]),
];

/// A pose up to the translation along the optical axis, which a 1D radial camera does not observe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadialPose {
    /// World to the camera whose optical axis is the ray of the common image point.
    pub rotation: Rotation3<f64>,
    /// The two components of the translation across that axis, map units.
    pub offset: Vector2<f64>,
}

impl RadialPose {
    /// Coordinates of a point across the optical axis: its image lies in this direction from the common image point.
    pub fn across(&self, point: &Point3<World>) -> Vector2<f64> {
        (self.rotation * point.coords).xy() + self.offset
    }
}

/// Pose of a 1D radial camera from five half-lines (calibrated, minimal).
///
/// All lines of one anchor of Dual Convergent Lines share the ray of the anchor. In the camera rotated so that this ray
/// is the optical axis, the direction of each map point from the principal point is known:
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
/// Appends 0 to 4 poses to `out`, as long as it has space, and returns how many. All five points lie on their
/// half-lines; whether they are in front of the camera depends on the depth, which is not known yet. Order is
/// unspecified but the same for the same input. Never panics; non-finite input gives 0 poses.
///
/// # Degenerate samples
/// Repeated pairs and points in one plane with the optical axis leave equations missing and give 0 poses or poor ones.
///
/// # Method and cost
/// Five equations are linear in the first two rows of `(R | t)`. The two whose directions differ most give `t`;
/// substituted into the others, they leave three equations in the rows of `R`, with a null space of three dimensions
/// (elimination with complete pivoting). The conditions that the two rows are perpendicular and of equal length are two
/// conics in it, which meet in at most four points. No allocation, no randomness. Runtime: see
/// `benches/benches/solvers.rs`.
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
    let center = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) * 0.2;
    let x: [Vector3<f64>; 5] = std::array::from_fn(|i| points[i].coords - center);
    let extent =
        x.iter().map(Vector3::norm_squared).fold(0.0, |m: f64, d| if d > m || d.is_nan() { d } else { m });
    let u: [Vector2<f64>; 5] =
        std::array::from_fn(|i| directions[i] * (1.0 / directions[i].norm_squared().sqrt()));
    let finite = u.iter().fold(0.0, |sum, u| sum + u.x + u.y).is_finite() && extent.is_finite();
    if !(finite && extent > 0.0 && extent > 1e-24 * center.norm_squared()) {
        return 0;
    }
    let Some(offset) = Offset::of(&u) else { return 0 };
    let Some(basis) = null_space(offset.eliminated(&u, &x), extent.sqrt()) else { return 0 };

    let form = |f: &dyn Fn(usize, usize) -> f64| Conic {
        xx: f(0, 0),
        xy: f(0, 1),
        xz: f(0, 2),
        yy: f(1, 1),
        yz: f(1, 2),
        zz: f(2, 2),
    };
    let perpendicular = form(&|i, j| 0.5 * (basis[i].0.dot(&basis[j].1) + basis[j].0.dot(&basis[i].1)));
    let equal = form(&|i, j| 0.5 * (basis[i].0.dot(&basis[j].0) - basis[i].1.dot(&basis[j].1)));

    let mut appended = 0;
    for mut weights in conics::intersect(&perpendicular, &equal) {
        if weights.sum().is_nan() {
            continue;
        }
        let rows = |w: &Vector3<f64>| {
            (
                basis[0].0 * w.x + basis[1].0 * w.y + basis[2].0 * w.z,
                basis[0].1 * w.x + basis[1].1 * w.y + basis[2].1 * w.z,
            )
        };
        let (mut r1, mut r2) = rows(&weights);
        if !similar(&r1, &r2, EXACT) {
            weights = conics::polished(&perpendicular, &equal, &weights);
            (r1, r2) = rows(&weights);
            if !similar(&r1, &r2, SOUND) {
                continue;
            }
        }
        let t = offset.of_rows(&u, &x, &r1, &r2);
        // The sign puts the first point on its half-line; all others must agree.
        let along = |i: usize| u[i].x * (r1.dot(&x[i]) + t.x) + u[i].y * (r2.dot(&x[i]) + t.y);
        let sign = 1.0_f64.copysign(along(0));
        if !(0..5).all(|i| sign * along(i) > 0.0) {
            continue;
        }
        let inverse = sign / r1.norm();
        let e1 = r1 * inverse;
        let e2 = r2 - e1 * e1.dot(&r2);
        let e2 = e2 * (sign / e2.norm());
        let rotation = Matrix3::from_rows(&[e1.transpose(), e2.transpose(), e1.cross(&e2).transpose()]);
        let offset = t * inverse - Vector2::new(e1.dot(&center), e2.dot(&center));
        let pose = RadialPose { rotation: Rotation3::from_matrix_unchecked(rotation), offset };
        if (rotation.sum() + offset.sum()).is_finite() && out.try_push(pose).is_ok() {
            appended += 1;
        }
    }
    appended
}

/// Whether two rows are perpendicular and of equal length to a tolerance relative to their length.
fn similar(r1: &Vector3<f64>, r2: &Vector3<f64>, tolerance: f64) -> bool {
    let (a, b) = (r1.norm_squared(), r2.norm_squared());
    let worst = tolerance * (a + b);
    a + b > 0.0 && (a - b).abs() < worst && r1.dot(r2).abs() < worst
}

/// The two lines through which the translation is eliminated.
struct Offset {
    pair: [usize; 2],
    others: [usize; 3],
    /// Cross product of their directions.
    cross: f64,
}

impl Offset {
    /// The two directions nearest to a right angle; `None` when all are parallel.
    fn of(u: &[Vector2<f64>; 5]) -> Option<Self> {
        let (mut best, mut at, mut k) = (PARALLEL, PAIRS.len(), 0);
        for a in 0..4 {
            for b in a + 1..5 {
                let size = cross(&u[a], &u[b]).abs();
                at = if size > best { k } else { at };
                best = if size > best { size } else { best };
                k += 1;
            }
        }
        let &(pair, others) = PAIRS.get(at)?;
        Some(Self { pair, others, cross: cross(&u[pair[0]], &u[pair[1]]) })
    }

    /// The other three equations without `t`, in the six numbers of `r1` and `r2`.
    fn eliminated(&self, u: &[Vector2<f64>; 5], x: &[Vector3<f64>; 5]) -> [[f64; 6]; 3] {
        let [a, b] = self.pair;
        // u_i × v = 0 with u_i (u_a × u_b) = u_a (u_i × u_b) + u_b (u_a × u_i).
        self.others.map(|i| {
            let y = [x[i] * self.cross, x[a] * -cross(&u[i], &u[b]), x[b] * -cross(&u[a], &u[i])];
            let first = -(y[0] * u[i].y + y[1] * u[a].y + y[2] * u[b].y);
            let second = y[0] * u[i].x + y[1] * u[a].x + y[2] * u[b].x;
            [first.x, first.y, first.z, second.x, second.y, second.z]
        })
    }

    /// `t` of the two lines: `u × t = −u × (r1·x, r2·x)` for both.
    fn of_rows(
        &self,
        u: &[Vector2<f64>; 5],
        x: &[Vector3<f64>; 5],
        r1: &Vector3<f64>,
        r2: &Vector3<f64>,
    ) -> Vector2<f64> {
        let [a, b] = self.pair;
        let off = |i: usize| cross(&u[i], &Vector2::new(r1.dot(&x[i]), r2.dot(&x[i])));
        (u[a] * off(b) - u[b] * off(a)) * (1.0 / self.cross)
    }
}

fn cross(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

/// Basis of the null space of three equations in six unknowns, each vector as its two halves; `None` when the equations
/// are dependent. `size` is the size of the coefficients.
fn null_space(mut rows: [[f64; 6]; 3], size: f64) -> Option<[(Vector3<f64>, Vector3<f64>); 3]> {
    let mut unknowns = [0, 1, 2, 3, 4, 5];
    for k in 0..3 {
        // The largest remaining number as pivot, so that values do not grow and a dependent equation is detected.
        let (mut best, mut pivot_at) = (0.0, (k, k));
        for (r, row) in rows.iter().enumerate().skip(k) {
            for (c, value) in row.iter().enumerate().skip(k) {
                pivot_at = if value.abs() > best { (r, c) } else { pivot_at };
                best = if value.abs() > best { value.abs() } else { best };
            }
        }
        if !(best > MISSING * size) {
            return None;
        }
        rows.swap(k, pivot_at.0);
        unknowns.swap(k, pivot_at.1);
        for row in &mut rows {
            row.swap(k, pivot_at.1);
        }
        let inverse = 1.0 / rows[k][k];
        let pivot = rows[k].map(|c| c * inverse);
        rows[k] = pivot;
        for r in (0..3).filter(|&r| r != k) {
            let factor = rows[r][k];
            for c in k + 1..6 {
                rows[r][c] -= factor * pivot[c];
            }
        }
    }
    Some([3, 4, 5].map(|free| {
        let mut v = [0.0; 6];
        v[unknowns[free]] = 1.0;
        for k in 0..3 {
            v[unknowns[k]] = -rows[k][free];
        }
        (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }))
}
