//! Intersection of two conics of the projective plane.
//!
//! A root of a cubic gives a degenerate member of their pencil, which consists of two lines, and each line meets
//! another member in at most two points. One root is enough: with four common points every root gives real lines, with
//! two there is one real root, with none the result does not matter. The root farthest from the two others is used,
//! because two of the three merge when two common points do.
//!
//! The vertex of a degenerate member `C`, the common point of both lines, is in every column of its adjugate. With the
//! vertex's largest coordinate at index `k`, each line is represented by its point with coordinate `k` equal to zero, a
//! root of the binary form of `C` in the two other coordinates. Everything stays homogeneous: no division by a small
//! number.

use std::hint::select_unpredictable;

use nalgebra::Vector3;

/// Added to discriminants, relative to their terms: a double root plus rounding stays real.
const TANGENT: f64 = 1e-13;

/// A conic `pᵀ C p = 0` by the upper triangle of its symmetric matrix.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conic {
    pub(crate) xx: f64,
    pub(crate) xy: f64,
    pub(crate) xz: f64,
    pub(crate) yy: f64,
    pub(crate) yz: f64,
    pub(crate) zz: f64,
}

impl Conic {
    fn times(&self, p: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            self.xx * p.x + self.xy * p.y + self.xz * p.z,
            self.xy * p.x + self.yy * p.y + self.yz * p.z,
            self.xz * p.x + self.yz * p.y + self.zz * p.z,
        )
    }

    fn rows(&self) -> [[f64; 3]; 3] {
        let &Self { xx, xy, xz, yy, yz, zz } = self;
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    /// `s A + t B`.
    fn blend(s: f64, a: &Self, t: f64, b: &Self) -> Self {
        Self {
            xx: s * a.xx + t * b.xx,
            xy: s * a.xy + t * b.xy,
            xz: s * a.xz + t * b.xz,
            yy: s * a.yy + t * b.yy,
            yz: s * a.yz + t * b.yz,
            zz: s * a.zz + t * b.zz,
        }
    }

    fn adjugate(&self) -> Self {
        Self {
            xx: self.yy * self.zz - self.yz * self.yz,
            xy: self.xz * self.yz - self.xy * self.zz,
            xz: self.xy * self.yz - self.xz * self.yy,
            yy: self.xx * self.zz - self.xz * self.xz,
            yz: self.xy * self.xz - self.xx * self.yz,
            zz: self.xx * self.yy - self.xy * self.xy,
        }
    }

    /// Trace of the product of both matrices.
    fn dot(&self, other: &Self) -> f64 {
        self.xx * other.xx
            + self.yy * other.yy
            + self.zz * other.zz
            + 2.0 * (self.xy * other.xy + self.xz * other.xz + self.yz * other.yz)
    }

    /// First row times first column of the adjugate: the determinant.
    fn determinant(&self, adjugate: &Self) -> f64 {
        self.xx * adjugate.xx + self.xy * adjugate.xy + self.xz * adjugate.xz
    }
}

/// The common points of two conics as vectors of any length and either sign; NaN in place of complex ones.
///
/// Accurate to about ten digits; [`polished`] refines them where the caller does not polish them otherwise. The number
/// of real points is unpredictable, so nothing here branches on it.
#[inline]
pub(crate) fn intersect(first: &Conic, second: &Conic) -> [Vector3<f64>; 4] {
    let (a1, a2) = (first.adjugate(), second.adjugate());
    // det(D1 + γ D2), constant term first.
    let c = [first.determinant(&a1), a1.dot(second), a2.dot(first), second.determinant(&a2)];
    // In the chart whose leading coefficient is larger; either is as likely.
    let reversed = c[0].abs() > c[3].abs();
    let either = |if_reversed: f64, otherwise: f64| select_unpredictable(reversed, if_reversed, otherwise);
    let [below, above] =
        outermost_root(either(c[0], c[3]), either(c[1], c[2]), either(c[2], c[1]), either(c[3], c[0]));
    let (s, t) = (either(above, below), either(below, above));
    let conic = Conic::blend(s, first, t, second);
    let other = [second, first][usize::from(t.abs() > s.abs())];

    let adjugate = conic.adjugate();
    let k = largest([-adjugate.xx, -adjugate.yy, -adjugate.zz]);
    let (i, j) = ([1, 2, 0][k], [2, 0, 1][k]);
    let vertex = adjugate.rows()[k];
    let (rows, rest) = (conic.rows(), other.rows());
    // The square root of a negative number is NaN: complex lines.
    let apart = -(rows[i][j] + (-vertex[k]).sqrt().copysign(rows[i][j]));
    let image = other.times(&Vector3::from(vertex));
    let a = vertex[0] * image.x + vertex[1] * image.y + vertex[2] * image.z;
    let mut points = [Vector3::zeros(); 4];
    for (n, [x, y]) in [[apart, rows[i][i]], [rows[j][j], apart]].into_iter().enumerate() {
        // σ vertex + τ (x, y, 0) on the other conic: a σ² + 2 b σ τ + c τ² = 0.
        let b = x * image[i] + y * image[j];
        let c = x * (x * rest[i][i] + 2.0 * y * rest[i][j]) + y * y * rest[j][j];
        let (square, product) = (b * b, a * c);
        // A double root may come out slightly below zero by rounding; the root of any other negative number is NaN.
        let root = (square - product + TANGENT * (square + product.abs())).sqrt();
        let q = -(b + root.copysign(b));
        for (m, [s, t]) in [[q, a], [c, q]].into_iter().enumerate() {
            let p = [s * vertex[i] + t * x, s * vertex[j] + t * y, s * vertex[k]];
            let order = [[2, 0, 1], [1, 2, 0], [0, 1, 2]][k];
            points[2 * n + m] = Vector3::new(p[order[0]], p[order[1]], p[order[2]]);
        }
    }
    points
}

/// Of the real roots of `l x³ + a x² + b x + c` the one farthest from the others, as denominator and numerator.
fn outermost_root(l: f64, a: f64, b: f64, c: f64) -> [f64; 2] {
    const THIRD: f64 = 1.0 / 3.0;
    // l x = y − a/3 turns it into y³ + 3 p y + 2 q.
    let shift = a * THIRD;
    let p = b * l * THIRD - shift * shift;
    let q = shift * (shift * shift - 0.5 * b * l) + 0.5 * c * l * l;
    let discriminant = q * q + p * p * p;
    if discriminant > 0.0 {
        // Cardano's formula y = −(u − p/u) without its difference of two nearly equal numbers.
        let u = cube_root(q.abs() + discriminant.sqrt());
        let square = u * u;
        return [l, -2.0 * q * square / (square * (square + p) + p * p) - shift];
    }
    // y = −2 √−p cos(acos(r) / 3) for r = |q| / (−p)^{3/2} in [0, 1]: the quintic (interpolated at Chebyshev's
    // nodes) is within 2e-6 there, and one step of Newton's method on z³ − 3 z = 2 r within 2e-12.
    let root = (-p).sqrt();
    let r = (q.abs() / (root * -p)).min(1.0);
    let square = r * r;
    let z = (1.732_052_12 + 0.333_237_71 * r)
        + square * ((-0.095_050_03 + 0.043_799_25 * r) + square * (-0.017_932_9 + 0.003_894_6 * r));
    let square = z * z;
    let z = z - (z * (square - 3.0) - 2.0 * r) / (3.0 * (square - 1.0));
    [l, -q.signum() * root * z - shift]
}

/// Cube root of a positive number to ten digits: an initial value from the exponent, then Halley's method.
fn cube_root(x: f64) -> f64 {
    // A third of the bit pattern is a third of the logarithm; the constant makes the initial value accurate to 4 %.
    let mut y = f64::from_bits(x.to_bits() / 3 + 0x2A9F_7893_0000_0000);
    for _ in 0..2 {
        let cube = y * y * y;
        y *= (cube + 2.0 * x) / (2.0 * cube + x);
    }
    y
}

/// Index of the largest of three numbers, without branches, because each is equally likely.
pub(crate) fn largest([x, y, z]: [f64; 3]) -> usize {
    let second = usize::from(y > x);
    let third = usize::from(z > if y > x { y } else { x });
    second * (1 - third) + 2 * third
}

/// Newton's method on both conics along the unit sphere; a step is accepted only if it lowers the residual.
pub(crate) fn polished(d1: &Conic, d2: &Conic, start: &Vector3<f64>) -> Vector3<f64> {
    let mut point = start / start.norm().max(f64::MIN_POSITIVE);
    let mut images = (d1.times(&point), d2.times(&point));
    let mut now = (point.dot(&images.0), point.dot(&images.1));
    for _ in 0..4 {
        let size = now.0.abs().max(now.1.abs());
        if !(size > 1e-16) {
            break;
        }
        // Perpendicular to the point, and both equations to zero: p' = −(f1 C2 p × p + f2 p × C1 p) / (2 det).
        let (r1, r2) = (images.1.cross(&point), point.cross(&images.0));
        let determinant = 2.0 * images.0.dot(&r1);
        let next = point - (r1 * now.0 + r2 * now.1) / determinant;
        let next = next / next.norm().max(f64::MIN_POSITIVE);
        let next_images = (d1.times(&next), d2.times(&next));
        let then = (next.dot(&next_images.0), next.dot(&next_images.1));
        if !(then.0.abs().max(then.1.abs()) < size) {
            break;
        }
        (point, images, now) = (next, next_images, then);
    }
    point
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_planted_common_point_is_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut found, mut wrong, total) = (0, 0, 50_000);
        for _ in 0..total {
            let point = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0_f64)).normalize();
            let mut conic = || {
                let [xx, xy, xz, yy, yz, zz] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                let c = Conic { xx, xy, xz, yy, yz, zz };
                let off = point.dot(&c.times(&point));
                Conic { xx: xx - off, yy: yy - off, zz: zz - off, ..c }
            };
            let (d1, d2) = (conic(), conic());
            let on_both = |p: &Vector3<f64>| p.dot(&d1.times(p)).abs() + p.dot(&d2.times(p)).abs();
            let points = intersect(&d1, &d2).into_iter().filter(|p| !p.sum().is_nan());
            let points: Vec<_> = points.map(|p| polished(&d1, &d2, &p)).collect();
            // A pair of complex points that is almost real may come out as real by rounding.
            wrong += points.iter().filter(|p| !(on_both(p) < 1e-10)).count();
            found += usize::from(points.iter().any(|p| p.cross(&point).norm() < 1e-6));
        }
        assert!(found * 10_000 >= total * 9999, "{found} of {total}");
        assert!(wrong * 10_000 <= total, "{wrong} of {total}");
    }

    #[test]
    fn cube_roots() {
        for k in -300..300 {
            for x in [1.0, 1.7, 3.1, 6.0, 9.9] {
                let x = x * 10.0_f64.powi(k);
                assert!((cube_root(x) / x.cbrt() - 1.0).abs() < 1e-10, "{x:e}");
            }
        }
    }

    #[test]
    fn the_outermost_root_is_a_root_and_farthest_out() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let root = |l: f64, a: f64, b: f64, c: f64| {
            let [below, above] = outermost_root(l, l * a, l * b, l * c);
            above / below
        };
        for k in 0..100_000 {
            let mut r: [f64; 3] = std::array::from_fn(|_| rng.random_range(-3.0..3.0));
            if k % 3 == 0 {
                // Two roots that almost merge: the third must not lose accuracy.
                r[1] = r[0] + rng.random_range(-1e-7..1e-7);
            }
            let l = rng.random_range(-2.0..2.0) * 10.0_f64.powi(k % 9 - 4);
            let (a, b, c) =
                (-r[0] - r[1] - r[2], r[0] * r[1] + r[0] * r[2] + r[1] * r[2], -r[0] * r[1] * r[2]);
            let found = root(l, a, b, c);
            let middle = (r[0] + r[1] + r[2]) / 3.0;
            let farthest = r.iter().map(|x| (x - middle).abs()).fold(0.0, f64::max);
            // A triple root is accurate to only a third of the digits.
            if farthest < 0.05 {
                continue;
            }
            assert!(r.iter().any(|x| (x - found).abs() < 1e-9), "{r:?}: {found}");
            assert!((found - middle).abs() > farthest - 1e-6, "{r:?}: {found}");
            // One real root beside a complex pair.
            let (re, im) = (r[1], rng.random_range(1e-3..3.0));
            let square = re * re + im * im;
            let found = root(l, -r[0] - 2.0 * re, square + 2.0 * re * r[0], -r[0] * square);
            assert!((found - r[0]).abs() < 1e-7, "{} beside {re} ± {im} i: {found}", r[0]);
        }
        assert!((root(1.0, 0.0, 0.0, -8.0) - 2.0).abs() < 1e-9);
        assert!(root(1.0, f64::NAN, 0.0, 0.0).is_nan());
    }
}
