//! Where three quadrics of projective space meet: the rotations that satisfy three linear equations in `R`.
//!
//! A rotation is a unit quaternion `q = (w, x, y, z)` up to sign, and every entry of its matrix is a quadratic form
//! in `q`. Three equations `⟨M, R⟩ = 0` are thus three quadrics in projective 3-space, which meet in eight points.
//!
//! # Method
//! Two coordinates `(y, z)` are eliminated, the ratio of the other two, `x : w`, is kept (Kukelova, Heller and
//! Fitzgibbon, *Efficient Intersection of Three Quadrics and Applications in Computer Vision*, CVPR 2016). The three
//! equations are solved for `y²`, `yz`, `z²`, which become polynomials in `x` times `y`, `z`, `1`; then
//!
//! ```text
//! z · (y²) = y · (yz)        z · (yz) = y · (z²)        (yz)² = (y²)(z²)
//! ```
//!
//! are linear in `(y, z, 1)` with coefficients of degree at most four in `x`, and their determinant has degree eight.
//! Which two of the four coordinates are eliminated is a choice of six; the one whose 3×3 system for `y²`, `yz`, `z²`
//! has the largest determinant is taken. Roots at `x = ∞` are those with `w = 0` and are no special case in the
//! homogeneous result. Each solution is polished by Newton's method on the three quadrics and the unit sphere.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

use crate::polynomial::{add_scaled, evaluate, product, real_roots};

/// A quadratic form in `(w, x, y, z)` as its symmetric matrix.
pub(crate) type Quadric = Matrix4<f64>;

/// The two coordinates to eliminate, then the two whose ratio is solved for.
const SPLITS: [[usize; 4]; 6] =
    [[2, 3, 1, 0], [1, 3, 2, 0], [1, 2, 3, 0], [0, 3, 1, 2], [0, 2, 1, 3], [0, 1, 2, 3]];

/// Newton's method converges quadratically; from roots good to six digits three steps are plenty.
const POLISH_STEPS: usize = 6;

/// The form `q ↦ ⟨M, R(q)⟩`, where `R(q)` is the rotation matrix of the quaternion times its squared length.
pub(crate) fn quadric_of(m: &Matrix3<f64>) -> Quadric {
    let (xy, xz, yz) = (m.m12 + m.m21, m.m13 + m.m31, m.m23 + m.m32);
    let (wx, wy, wz) = (m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12);
    Matrix4::new(
        m.m11 + m.m22 + m.m33,
        wx,
        wy,
        wz, //
        wx,
        m.m11 - m.m22 - m.m33,
        xy,
        xz, //
        wy,
        xy,
        m.m22 - m.m11 - m.m33,
        yz, //
        wz,
        xz,
        yz,
        m.m33 - m.m11 - m.m22,
    )
}

/// Appends up to eight unit quaternions `(w, x, y, z)` on which all three forms vanish.
pub(crate) fn intersect(forms: &[Quadric; 3], out: &mut ArrayVec<Vector4<f64>, 8>) {
    let mut q = *forms;
    for form in &mut q {
        let norm = form.norm();
        if !(norm.is_finite() && norm > 0.0) {
            return;
        }
        *form /= norm;
    }
    let system = |split: &[usize; 4]| {
        let [y, z, ..] = *split;
        Matrix3::from_fn(|i, j| match j {
            0 => q[i][(y, y)],
            1 => 2.0 * q[i][(y, z)],
            _ => q[i][(z, z)],
        })
    };
    let Some((split, lhs, det)) = SPLITS
        .iter()
        .map(|s| (s, system(s)))
        .map(|(s, m)| (s, m, m.determinant().abs()))
        .max_by(|a, b| a.2.total_cmp(&b.2))
    else {
        return;
    };
    if !(det > 1e-14) {
        return;
    }
    let Some(inverse) = lhs.try_inverse() else { return };
    let [y, z, x, w] = *split;
    // Rows: y², yz, z² = p[0] y + p[1] z + p[2], polynomials in x (with w = 1).
    let column = |f: &dyn Fn(&Quadric) -> f64| -inverse * Vector3::new(f(&q[0]), f(&q[1]), f(&q[2]));
    let (y1, y0) = (column(&|f| 2.0 * f[(x, y)]), column(&|f| 2.0 * f[(w, y)]));
    let (z1, z0) = (column(&|f| 2.0 * f[(x, z)]), column(&|f| 2.0 * f[(w, z)]));
    let (c2, c1, c0) = (column(&|f| f[(x, x)]), column(&|f| 2.0 * f[(w, x)]), column(&|f| f[(w, w)]));
    let a: [[f64; 2]; 3] = std::array::from_fn(|i| [y0[i], y1[i]]);
    let b: [[f64; 2]; 3] = std::array::from_fn(|i| [z0[i], z1[i]]);
    let c: [[f64; 3]; 3] = std::array::from_fn(|i| [c0[i], c1[i], c2[i]]);

    let rows = eliminate(&a, &b, &c);
    for root in real_roots(&rows.determinant()) {
        let [r0, r1, r2] = rows.at(root);
        let null = [r0.cross(&r1), r0.cross(&r2), r1.cross(&r2)]
            .into_iter()
            .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
            .unwrap_or_default();
        let mut point = Vector4::zeros();
        point[y] = null.x;
        point[z] = null.y;
        point[w] = null.z;
        point[x] = root * null.z;
        if let Some(point) = polish(&q, point) {
            let known = out.iter().any(|o: &Vector4<f64>| o.dot(&point).abs() > 1.0 - 1e-14);
            if !known && out.try_push(point).is_err() {
                return;
            }
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
    let yy = add_scaled(&quad(&a[1], &a[1]), -1.0, &quad(&a[0], &a[2]));
    let yz: [f64; 3] =
        std::array::from_fn(|i| 2.0 * quad(&a[1], &b[1])[i] - quad(&a[0], &b[2])[i] - quad(&b[0], &a[2])[i]);
    let zz = add_scaled(&quad(&b[1], &b[1]), -1.0, &quad(&b[0], &b[2]));
    let by_y: [f64; 4] = std::array::from_fn(|i| {
        2.0 * cubic(&a[1], &c[1])[i] - cubic(&a[0], &c[2])[i] - cubic(&a[2], &c[0])[i]
    });
    let by_z: [f64; 4] = std::array::from_fn(|i| {
        2.0 * cubic(&b[1], &c[1])[i] - cubic(&b[0], &c[2])[i] - cubic(&b[2], &c[0])[i]
    });
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

    fn at(&self, x: f64) -> [Vector3<f64>; 3] {
        let (f, s, t) = (&self.first, &self.second, &self.third);
        let unit = |v: Vector3<f64>| v / v.norm().max(f64::MIN_POSITIVE);
        [
            unit(Vector3::new(evaluate(&f.0, x), evaluate(&f.1, x), evaluate(&f.2, x))),
            unit(Vector3::new(evaluate(&s.0, x), evaluate(&s.1, x), evaluate(&s.2, x))),
            unit(Vector3::new(evaluate(&t.0, x), evaluate(&t.1, x), evaluate(&t.2, x))),
        ]
    }
}

/// Newton's method on the three quadrics and the unit sphere; `None` when it does not arrive.
fn polish(q: &[Quadric; 3], start: Vector4<f64>) -> Option<Vector4<f64>> {
    let mut point = start.try_normalize(0.0).filter(|p| p.iter().all(|c| c.is_finite()))?;
    for _ in 0..POLISH_STEPS {
        let images = [q[0] * point, q[1] * point, q[2] * point];
        let residual = Vector4::new(point.dot(&images[0]), point.dot(&images[1]), point.dot(&images[2]), 0.0);
        if residual.amax() < 1e-15 {
            break;
        }
        let jacobian = Matrix4::from_rows(&[
            2.0 * images[0].transpose(),
            2.0 * images[1].transpose(),
            2.0 * images[2].transpose(),
            point.transpose(),
        ]);
        let Some(step) = jacobian.lu().solve(&residual) else { break };
        let length = step.norm();
        if !length.is_finite() {
            return None;
        }
        // Far off the linear model the direction is still good, its length is not.
        point = (point - step * (0.5 / length).min(1.0)).normalize();
        if length < 1e-14 {
            break;
        }
    }
    let worst = q.iter().map(|q| point.dot(&(q * point)).abs()).fold(0.0_f64, f64::max);
    (worst < 1e-10).then_some(point)
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

    fn random_quadric(rng: &mut ChaCha8Rng, through: &Vector4<f64>) -> Quadric {
        let m = Matrix4::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let m = m + m.transpose();
        m - Matrix4::identity() * through.dot(&(m * through))
    }

    #[test]
    fn the_form_of_a_matrix_is_its_product_with_the_rotation() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..100 {
            let m = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let q = Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0)).normalize();
            let r =
                UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix();
            assert!((q.dot(&(quadric_of(&m) * q)) - m.dot(r.matrix())).abs() < 1e-12);
        }
    }

    #[test]
    fn a_planted_common_point_is_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut found, total) = (0, 10_000);
        for _ in 0..total {
            let point = Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0_f64)).normalize();
            let forms: [Quadric; 3] = std::array::from_fn(|_| random_quadric(&mut rng, &point));
            let mut out = ArrayVec::new();
            intersect(&forms, &mut out);
            for p in &out {
                for f in &forms {
                    assert!(p.dot(&(f * p)).abs() < 1e-8 * f.norm());
                }
            }
            found += usize::from(out.iter().any(|p| p.dot(&point).abs() > 1.0 - 1e-10));
        }
        assert!(found * 1000 >= total * 999, "{found} of {total}");
    }
}
