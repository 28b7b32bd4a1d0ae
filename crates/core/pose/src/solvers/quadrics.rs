//! Intersection of three quadrics of projective space: the rotations that satisfy three linear equations in `R`.
//!
//! A rotation is a unit quaternion `q = (w, x, y, z)` up to sign, and every entry of its matrix is a quadratic form
//! in `q`. Three equations `⟨M, R⟩ = 0` are thus three quadrics in projective 3-space, which meet in eight points.
//!
//! # Method
//! Two coordinates `(y, z)` are eliminated, the ratio of the other two, `x : w`, remains (Kukelova, Heller and
//! Fitzgibbon, *Efficient Intersection of Three Quadrics and Applications in Computer Vision*, CVPR 2016). The three
//! equations are solved for `y²`, `yz`, `z²`, which become polynomials in `x` times `y`, `z`, `1`; then
//!
//! ```text
//! z · (y²) = y · (yz)        z · (yz) = y · (z²)        (yz)² = (y²)(z²)
//! ```
//!
//! are linear in `(y, z, 1)` with coefficients of degree at most four in `x`, and their determinant has degree eight.
//! The pair of eliminated coordinates is one of six; the pair whose 3×3 system for `y²`, `yz`, `z²` has the largest
//! determinant is used. Roots at `x = ∞` have `w = 0` and are no special case in the homogeneous result. Solutions are
//! accurate to about ten digits; the caller polishes those that it uses.

use nalgebra::{Matrix3, Vector3, Vector4};

use crate::solvers::polynomial::{add_scaled, evaluate, octic_roots, product};

/// A quadratic form in `(w, x, y, z)` by the upper triangle of its symmetric matrix, row by row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Quadric([f64; 10]);

/// Index of the entry of row `i`, column `j`.
const INDEX: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];

/// The two coordinates to eliminate, then the two whose ratio is solved for.
const SPLITS: [[usize; 4]; 6] =
    [[2, 3, 1, 0], [1, 3, 2, 0], [1, 2, 3, 0], [0, 3, 1, 2], [0, 2, 1, 3], [0, 1, 2, 3]];

/// Sine of the angle between two of the three equations in `(y, z, 1)` below which the third is used as well.
const PARALLEL: f64 = 1e-4;

/// Newton's method converges quadratically; from roots accurate to six digits three steps are enough.
const POLISH_STEPS: usize = 6;

impl Quadric {
    /// The form `q ↦ ⟨M, R(q)⟩`, where `R(q)` is the rotation matrix of the quaternion times its squared length.
    pub(crate) fn of(m: &Matrix3<f64>) -> Self {
        Self([
            m.m11 + m.m22 + m.m33,
            m.m32 - m.m23,
            m.m13 - m.m31,
            m.m21 - m.m12,
            m.m11 - m.m22 - m.m33,
            m.m12 + m.m21,
            m.m13 + m.m31,
            m.m22 - m.m11 - m.m33,
            m.m23 + m.m32,
            m.m33 - m.m11 - m.m22,
        ])
    }

    /// Scaled to about unit norm; `None` when it vanishes or is not finite.
    fn unit(&self) -> Option<Self> {
        let square = self.0.iter().fold(0.0, |sum, c| sum + c * c);
        let inverse = 1.0 / square.sqrt();
        (inverse > 0.0 && inverse.is_finite()).then(|| Self(self.0.map(|c| c * inverse)))
    }

    #[inline]
    fn times(&self, p: &Vector4<f64>) -> Vector4<f64> {
        let q = &self.0;
        Vector4::new(
            q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3],
            q[1] * p[0] + q[4] * p[1] + q[5] * p[2] + q[6] * p[3],
            q[2] * p[0] + q[5] * p[1] + q[7] * p[2] + q[8] * p[3],
            q[3] * p[0] + q[6] * p[1] + q[8] * p[2] + q[9] * p[3],
        )
    }
}

/// Calls `visit` with the common points of three forms: up to eight quaternions `(w, x, y, z)` of unit length.
#[inline]
pub(crate) fn intersect(forms: &[Quadric; 3], mut visit: impl FnMut(Vector4<f64>)) {
    let [Some(a), Some(b), Some(c)] = forms.each_ref().map(Quadric::unit) else { return };
    // By coefficient, then by equation.
    let at = |i: usize, j: usize| {
        let k = INDEX[i][j];
        Vector3::new(a.0[k], b.0[k], c.0[k])
    };
    let (mut best, mut split) = (1e-14, None);
    for candidate in &SPLITS {
        let [y, z, ..] = *candidate;
        let det = 2.0 * at(y, y).cross(&at(y, z)).dot(&at(z, z)).abs();
        if det > best {
            (best, split) = (det, Some(candidate));
        }
    }
    let Some(&[y, z, x, w]) = split else { return };
    // Rows: y², yz, z² = a y + b z + c, polynomials in x (with w = 1). Minus the inverse by its dual basis.
    let (yy, yz, zz) = (at(y, y), 2.0 * at(y, z), at(z, z));
    let duals = [yz.cross(&zz), zz.cross(&yy), yy.cross(&yz)];
    let scale = -1.0 / yy.dot(&duals[0]);
    let duals = duals.map(|d| d * scale);
    let solve = |v: Vector3<f64>| duals.map(|d| d.dot(&v));
    let (y1, y0) = (solve(2.0 * at(x, y)), solve(2.0 * at(w, y)));
    let (z1, z0) = (solve(2.0 * at(x, z)), solve(2.0 * at(w, z)));
    let (c2, c1, c0) = (solve(at(x, x)), solve(2.0 * at(w, x)), solve(at(w, w)));
    let a: [[f64; 2]; 3] = std::array::from_fn(|i| [y0[i], y1[i]]);
    let b: [[f64; 2]; 3] = std::array::from_fn(|i| [z0[i], z1[i]]);
    let c: [[f64; 3]; 3] = std::array::from_fn(|i| [c0[i], c1[i], c2[i]]);

    let rows = eliminate(&a, &b, &c);
    for root in octic_roots(&rows.determinant()) {
        let null = rows.null_at(root);
        let mut point = [0.0; 4];
        (point[y], point[z], point[w], point[x]) = (null.x, null.y, null.z, root * null.z);
        let [w, x, y, z] = point;
        let inverse = 1.0 / (w * w + x * x + y * y + z * z).sqrt();
        if inverse.is_finite() {
            visit(Vector4::new(w * inverse, x * inverse, y * inverse, z * inverse));
        }
    }
}

/// The three equations linear in `(y, z, 1)`: two rows of degree (2, 2, 3) and one of degree (3, 3, 4) in `x`.
struct Rows {
    first: ([f64; 3], [f64; 3], [f64; 4]),
    second: ([f64; 3], [f64; 3], [f64; 4]),
    third: ([f64; 4], [f64; 4], [f64; 5]),
}

fn eliminate(a: &[[f64; 2]; 3], b: &[[f64; 2]; 3], c: &[[f64; 3]; 3]) -> Rows {
    let quad = |p: &[f64; 2], q: &[f64; 2]| -> [f64; 3] { product(p, q) };
    let cubic = |p: &[f64; 2], q: &[f64; 3]| -> [f64; 4] { product(p, q) };
    // z(y²) − y(yz): (a0 − b1) yz + b0 z² − a1 y² + c0 z − c1 y
    let d = add_scaled(&a[0], -1.0, &b[1]);
    let first = (
        sum([quad(&d, &a[1]), quad(&b[0], &a[2]), neg(quad(&a[1], &a[0])), neg(c[1])]),
        sum([quad(&d, &b[1]), quad(&b[0], &b[2]), neg(quad(&a[1], &b[0])), c[0]]),
        sum([cubic(&d, &c[1]), cubic(&b[0], &c[2]), neg(cubic(&a[1], &c[0]))]),
    );
    // z(yz) − y(z²): (a1 − b2) yz + b1 z² − a2 y² + c1 z − c2 y
    let d = add_scaled(&a[1], -1.0, &b[2]);
    let second = (
        sum([quad(&d, &a[1]), quad(&b[1], &a[2]), neg(quad(&a[2], &a[0])), neg(c[2])]),
        sum([quad(&d, &b[1]), quad(&b[1], &b[2]), neg(quad(&a[2], &b[0])), c[1]]),
        sum([cubic(&d, &c[1]), cubic(&b[1], &c[2]), neg(cubic(&a[2], &c[0]))]),
    );
    // (yz)² − (y²)(z²), with y², yz, z² replaced once more.
    let twice = |p: [f64; 2]| p.map(|x| 2.0 * x);
    let (a1, b1) = (twice(a[1]), twice(b[1]));
    let yy = add_scaled(&quad(&a[1], &a[1]), -1.0, &quad(&a[0], &a[2]));
    let yz = sum([quad(&a1, &b[1]), neg(quad(&a[0], &b[2])), neg(quad(&b[0], &a[2]))]);
    let zz = add_scaled(&quad(&b[1], &b[1]), -1.0, &quad(&b[0], &b[2]));
    let by_y = sum([cubic(&a1, &c[1]), neg(cubic(&a[0], &c[2])), neg(cubic(&a[2], &c[0]))]);
    let by_z = sum([cubic(&b1, &c[1]), neg(cubic(&b[0], &c[2])), neg(cubic(&b[2], &c[0]))]);
    let alone: [f64; 5] = add_scaled(&product(&c[1], &c[1]), -1.0, &product(&c[0], &c[2]));
    let third = (
        sum([cubic(&a[0], &yy), cubic(&a[1], &yz), cubic(&a[2], &zz), by_y]),
        sum([cubic(&b[0], &yy), cubic(&b[1], &yz), cubic(&b[2], &zz), by_z]),
        sum([product(&yy, &c[0]), product(&yz, &c[1]), product(&zz, &c[2]), alone]),
    );
    Rows { first, second, third }
}

impl Rows {
    fn determinant(&self) -> [f64; 9] {
        let (f, s, t) = (&self.first, &self.second, &self.third);
        let minor_yz: [f64; 5] = add_scaled(&product(&f.0, &s.1), -1.0, &product(&s.0, &f.1));
        let minor_y1: [f64; 6] = add_scaled(&product(&f.0, &s.2), -1.0, &product(&s.0, &f.2));
        let minor_z1: [f64; 6] = add_scaled(&product(&f.1, &s.2), -1.0, &product(&s.1, &f.2));
        sum([product(&minor_yz, &t.2), neg(product(&minor_y1, &t.1)), product(&minor_z1, &t.0)])
    }

    /// The vector `(y, z, 1)`, of any length, on which the rows vanish at a root.
    fn null_at(&self, x: f64) -> Vector3<f64> {
        let low = |r: &([f64; 3], [f64; 3], [f64; 4])| {
            Vector3::new(evaluate(&r.0, x), evaluate(&r.1, x), evaluate(&r.2, x))
        };
        let (r0, r1) = (low(&self.first), low(&self.second));
        let null = r0.cross(&r1);
        if null.norm_squared() > PARALLEL * PARALLEL * r0.norm_squared() * r1.norm_squared() {
            return null;
        }
        let t = &self.third;
        let r2 = Vector3::new(evaluate(&t.0, x), evaluate(&t.1, x), evaluate(&t.2, x));
        let unit = |v: Vector3<f64>| v / v.norm().max(f64::MIN_POSITIVE);
        let (r0, r1, r2) = (unit(r0), unit(r1), unit(r2));
        [r0.cross(&r1), r0.cross(&r2), r1.cross(&r2)]
            .into_iter()
            .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
            .unwrap_or_default()
    }
}

/// Newton's method on the three forms along the unit sphere; `None` when it does not converge.
#[inline]
pub(crate) fn polished(forms: &[Quadric; 3], start: &Vector4<f64>) -> Option<Vector4<f64>> {
    let mut q = *start;
    for _ in 0..POLISH_STEPS {
        let images = forms.each_ref().map(|f| f.times(&q));
        let residual = images.map(|i| q.dot(&i));
        // Half the derivative along q·i, q·j, q·k, the directions in which the rotation can turn.
        let row = |v: &Vector4<f64>| {
            Vector3::new(
                -q[1] * v[0] + q[0] * v[1] + q[3] * v[2] - q[2] * v[3],
                -q[2] * v[0] - q[3] * v[1] + q[0] * v[2] + q[1] * v[3],
                -q[3] * v[0] + q[2] * v[1] - q[1] * v[2] + q[0] * v[3],
            )
        };
        let [a, b, c] = images.each_ref().map(row);
        let (bc, ca, ab) = (b.cross(&c), c.cross(&a), a.cross(&b));
        let turn = (bc * residual[0] + ca * residual[1] + ab * residual[2]) * (-0.5 / a.dot(&bc));
        let square = turn.norm_squared();
        if !square.is_finite() {
            break;
        }
        // Far from the solution the direction is still good, but the length is not.
        let turn = if square > 0.25 { turn * (0.5 / square.sqrt()) } else { turn };
        let next = Vector4::new(
            q[0] - q[1] * turn.x - q[2] * turn.y - q[3] * turn.z,
            q[1] + q[0] * turn.x - q[3] * turn.y + q[2] * turn.z,
            q[2] + q[3] * turn.x + q[0] * turn.y - q[1] * turn.z,
            q[3] - q[2] * turn.x + q[1] * turn.y + q[0] * turn.z,
        );
        q = next * (1.0 / next.norm_squared().sqrt());
        // The forms are quadratic: the remaining error is about the square of the step.
        if square < 1e-16 {
            return Some(q);
        }
    }
    let worst =
        forms.iter().map(|f| q.dot(&f.times(&q)).abs()).fold(0.0, |m: f64, r| if r > m { r } else { m });
    let size = forms.iter().map(|f| f.0.iter().fold(0.0, |s, c| s + c * c)).fold(0.0, f64::max).sqrt();
    (worst < 1e-10 * size && q.norm_squared().is_finite()).then_some(q)
}

fn sum<const N: usize, const K: usize>(terms: [[f64; N]; K]) -> [f64; N] {
    std::array::from_fn(|i| terms.iter().map(|t| t[i]).sum())
}

fn neg<const N: usize>(p: [f64; N]) -> [f64; N] {
    p.map(|c| -c)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Quaternion, UnitQuaternion};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_form_of_a_matrix_is_its_product_with_the_rotation() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..100 {
            let m = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let q = Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0)).normalize();
            let r =
                UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix();
            assert!((q.dot(&Quadric::of(&m).times(&q)) - m.dot(r.matrix())).abs() < 1e-12);
        }
    }

    #[test]
    fn a_planted_common_point_is_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut found, total) = (0, 20_000);
        for _ in 0..total {
            let point = Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0_f64)).normalize();
            let forms = [(); 3].map(|()| {
                let form = Quadric(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let off = point.dot(&form.times(&point));
                Quadric(std::array::from_fn(|k| {
                    form.0[k] - if [0, 4, 7, 9].contains(&k) { off } else { 0.0 }
                }))
            });
            let mut here = false;
            intersect(&forms, |raw| {
                assert!((raw.norm() - 1.0).abs() < 1e-12);
                let Some(p) = polished(&forms, &raw) else { return };
                for f in &forms {
                    assert!(p.dot(&f.times(&p)).abs() < 1e-9);
                }
                here |= p.dot(&point).abs() > 1.0 - 1e-10;
            });
            found += usize::from(here);
        }
        assert!(found * 10_000 >= total * 9995, "{found} of {total}");
    }
}
