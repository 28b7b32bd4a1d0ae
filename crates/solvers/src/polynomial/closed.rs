//! Closed forms for degrees two to four, each root polished by Newton's method on the polynomial itself.

use arrayvec::ArrayVec;

use super::evaluate_with_slope;

/// Coefficients this small beside the largest one are rounding.
const NEGLIGIBLE: f64 = 1e-14;

/// Real roots of `c0 + c1 x + c2 x²`, rising; a double root once.
///
/// Uses the form of the formula that never subtracts nearly equal numbers.
pub fn quadratic_roots(c: &[f64; 3]) -> ArrayVec<f64, 2> {
    let mut roots = ArrayVec::new();
    let Some(size) = magnitude(c) else { return roots };
    if c[2].abs() <= NEGLIGIBLE * size {
        if c[1].abs() > NEGLIGIBLE * size {
            roots.push(-c[0] / c[1]);
        }
        return roots;
    }
    let discriminant = c[1] * c[1] - 4.0 * c[2] * c[0];
    if discriminant < 0.0 {
        return roots;
    }
    let root = discriminant.sqrt();
    let q = -0.5 * (c[1] + if c[1] < 0.0 { -root } else { root });
    if q == 0.0 {
        roots.push(0.0);
        return roots;
    }
    let (a, b) = (q / c[2], c[0] / q);
    roots.push(a.min(b));
    if root > 0.0 {
        roots.push(a.max(b));
    }
    roots
}

/// Real roots of `c0 + c1 x + c2 x² + c3 x³`, rising.
pub fn cubic_roots(c: &[f64; 4]) -> ArrayVec<f64, 3> {
    let mut roots = ArrayVec::new();
    let Some(size) = magnitude(c) else { return roots };
    if c[3].abs() <= NEGLIGIBLE * size {
        roots.extend(quadratic_roots(&[c[0], c[1], c[2]]));
        return roots;
    }
    // x = y - a/3 turns x³ + a x² + b x + d into y³ + 3 p y + 2 q.
    let (a, b, d) = (c[2] / c[3], c[1] / c[3], c[0] / c[3]);
    let shift = a / 3.0;
    let p = b / 3.0 - shift * shift;
    let q = shift * (shift * shift - b / 2.0) + d / 2.0;
    let discriminant = q * q + p * p * p;
    if discriminant > 0.0 {
        let w = q.abs() + discriminant.sqrt();
        let u = -q.signum() * w.cbrt();
        roots.push(u - if u == 0.0 { 0.0 } else { p / u } - shift);
    } else if p == 0.0 {
        roots.push(-shift);
    } else {
        let m = 2.0 * (-p).sqrt();
        let phi = (q / (p * (-p).sqrt())).clamp(-1.0, 1.0).acos() / 3.0;
        for k in 0..3 {
            roots.push(m * (phi - f64::from(k) * std::f64::consts::TAU / 3.0).cos() - shift);
        }
    }
    finish(c, &mut roots);
    roots
}

/// Real roots of `c0 + c1 x + c2 x² + c3 x³ + c4 x⁴`, rising (Ferrari's method).
pub fn quartic_roots(c: &[f64; 5]) -> ArrayVec<f64, 4> {
    let mut roots = ArrayVec::new();
    let Some(size) = magnitude(c) else { return roots };
    if c[4].abs() <= NEGLIGIBLE * size {
        roots.extend(cubic_roots(&[c[0], c[1], c[2], c[3]]));
        return roots;
    }
    let (b, d, e, f) = (c[3] / c[4], c[2] / c[4], c[1] / c[4], c[0] / c[4]);
    // Depressed: y⁴ + p y² + q y + r with x = y - b/4.
    let shift = b / 4.0;
    let b2 = shift * shift;
    let p = d - 6.0 * b2;
    let q = e - 2.0 * shift * d + 8.0 * shift * b2;
    let r = f - shift * e + b2 * d - 3.0 * b2 * b2;
    // A positive root of the resolvent m³ + p m² + (p²/4 - r) m - q²/8 splits it into two quadratics.
    let m = cubic_roots(&[-q * q / 8.0, p * p / 4.0 - r, p, 1.0]).last().copied().unwrap_or(0.0);
    if m > NEGLIGIBLE * (p.abs() + r.abs().sqrt()) {
        let s = (2.0 * m).sqrt();
        for sign in [1.0, -1.0] {
            let half = quadratic_roots(&[p / 2.0 + m - sign * q / (2.0 * s), sign * s, 1.0]);
            roots.extend(half.iter().map(|y| y - shift));
        }
    } else {
        for y2 in quadratic_roots(&[r, p, 1.0]) {
            if y2 >= 0.0 {
                let y = y2.sqrt();
                roots.push(-y - shift);
                if y > 0.0 {
                    roots.push(y - shift);
                }
            }
        }
    }
    finish(c, &mut roots);
    roots
}

fn magnitude(c: &[f64]) -> Option<f64> {
    let size = c.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    (c.iter().all(|x| x.is_finite()) && size > 0.0).then_some(size)
}

/// Polishes by Newton's method, keeping a step only when it lowers the residual, and sorts.
fn finish<const N: usize>(c: &[f64], roots: &mut ArrayVec<f64, N>) {
    for x in roots.iter_mut() {
        for _ in 0..3 {
            let (p, d) = evaluate_with_slope(c, *x);
            let next = *x - p / d;
            if !(evaluate_with_slope(c, next).0.abs() < p.abs()) {
                break;
            }
            *x = next;
        }
    }
    roots.retain(|x| x.is_finite());
    roots.sort_by(f64::total_cmp);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn check(expected: &[f64], found: &[f64], tolerance: f64) {
        assert_eq!(expected.len(), found.len(), "expected {expected:?}, found {found:?}");
        for (e, f) in expected.iter().zip(found) {
            assert!((e - f).abs() <= tolerance * (1.0 + e.abs()), "expected {expected:?}, found {found:?}");
        }
    }

    #[test]
    fn known_roots_are_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for _ in 0..20_000 {
            let mut r: [f64; 4] = std::array::from_fn(|_| rng.random_range(-3.0..3.0));
            r.sort_by(f64::total_cmp);
            if r.windows(2).any(|w| w[1] - w[0] < 1e-3) {
                continue;
            }
            let lead: f64 = rng.random_range(0.5..2.0);
            let quadratic = super::super::product::<2, 2, 3>(&[-r[0] * lead, lead], &[-r[1], 1.0]);
            let cubic = super::super::product::<3, 2, 4>(&quadratic, &[-r[2], 1.0]);
            let quartic = super::super::product::<4, 2, 5>(&cubic, &[-r[3], 1.0]);
            check(&r[..2], &quadratic_roots(&quadratic), 1e-11);
            check(&r[..3], &cubic_roots(&cubic), 1e-8);
            check(&r, &quartic_roots(&quartic), 1e-6);
            // A factor without real roots adds none.
            let pair = [1.0 + r[3] * r[3], 2.0 * r[3], 1.0 + 1e-3];
            check(&r[..1], &cubic_roots(&super::super::product(&pair, &[-r[0], 1.0])), 1e-8);
            check(&r[..2], &quartic_roots(&super::super::product(&pair, &quadratic)), 1e-6);
        }
    }

    #[test]
    fn special_polynomials() {
        check(&[0.0], &quadratic_roots(&[0.0, 0.0, 2.0]), 0.0);
        check(&[-2.0], &quadratic_roots(&[2.0, 1.0, 0.0]), 0.0);
        check(&[], &quadratic_roots(&[1.0, 0.0, 1.0]), 0.0);
        check(&[1.0], &cubic_roots(&[-1.0, 0.0, 0.0, 1.0]), 1e-15);
        check(&[0.0], &cubic_roots(&[0.0, 0.0, 0.0, 1.0]), 1e-15);
        check(&[-1.0, 1.0], &quartic_roots(&[-1.0, 0.0, 0.0, 0.0, 1.0]), 1e-14);
        check(&[-2.0, -1.0, 1.0, 2.0], &quartic_roots(&[4.0, 0.0, -5.0, 0.0, 1.0]), 1e-14);
        assert!(quartic_roots(&[f64::NAN, 0.0, 0.0, 0.0, 1.0]).is_empty());
        assert!(quartic_roots(&[0.0; 5]).is_empty());
        assert!(quadratic_roots(&[1.0, f64::INFINITY, 1.0]).is_empty());
    }
}
