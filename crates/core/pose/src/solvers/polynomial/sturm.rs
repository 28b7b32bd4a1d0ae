//! Real roots of any degree: Sturm's sequence isolates them, bisection guarded Newton steps find them.

use arrayvec::ArrayVec;

use super::evaluate_with_slope;

/// Capacity for the coefficients of the highest degree in use (eight), one row per member of the sequence.
const MAX: usize = 9;

/// All distinct real roots of a polynomial of degree at most eight, rising.
///
/// `N` is the number of coefficients (degree plus one), at most 9. Two roots closer than about 1e-9 of the root
/// bound count as one; a root of even multiplicity may be lost to rounding, as with every method in floating point.
pub fn real_roots<const N: usize>(coefficients: &[f64; N]) -> ArrayVec<f64, 8> {
    const { assert!(N <= MAX && N >= 1, "degree at most eight") };
    let mut roots = ArrayVec::new();
    let Some(chain) = Chain::new(coefficients) else { return roots };
    let bound = chain.root_bound();
    if !bound.is_finite() {
        return roots;
    }
    let mut stack: ArrayVec<Span, 64> = ArrayVec::new();
    let whole = Span {
        low: -bound,
        high: bound,
        above_low: chain.variations(-bound),
        above_high: chain.variations(bound),
    };
    stack.push(whole);
    while let Some(span) = stack.pop() {
        let count = span.above_low.saturating_sub(span.above_high);
        if count == 0 {
            continue;
        }
        let middle = 0.5 * (span.low + span.high);
        let narrow = span.high - span.low <= 1e-9 * bound.min(1.0 + span.low.abs());
        if count == 1 || narrow || stack.len() + 2 > stack.capacity() {
            if !roots.is_full() {
                roots.push(chain.refine(span.low, span.high));
            }
            continue;
        }
        let at_middle = chain.variations(middle);
        // The upper half is pushed first, so that the roots are found in rising order.
        stack.push(Span { low: middle, high: span.high, above_low: at_middle, above_high: span.above_high });
        stack.push(Span { low: span.low, high: middle, above_low: span.above_low, above_high: at_middle });
    }
    roots
}

/// An interval and Sturm's sign variations at both ends; their difference is the number of roots in `(low, high]`.
struct Span {
    low: f64,
    high: f64,
    above_low: usize,
    above_high: usize,
}

/// `p`, `p'`, and the negated remainders of each division, each scaled to largest coefficient one.
struct Chain {
    rows: [[f64; MAX]; MAX],
    degrees: [usize; MAX],
    len: usize,
}

impl Chain {
    fn new(coefficients: &[f64]) -> Option<Self> {
        let mut chain = Self { rows: [[0.0; MAX]; MAX], degrees: [0; MAX], len: 0 };
        let size = coefficients.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        if !(size > 0.0 && coefficients.iter().all(|c| c.is_finite())) {
            return None;
        }
        let mut first = [0.0; MAX];
        for (to, from) in first.iter_mut().zip(coefficients) {
            *to = from / size;
        }
        let degree = (0..coefficients.len()).rev().find(|&i| first[i].abs() > 1e-15)?;
        if degree == 0 {
            return None;
        }
        chain.push(first, degree);
        let mut slope = [0.0; MAX];
        for i in 1..=degree {
            slope[i - 1] = i as f64 * first[i];
        }
        chain.push_scaled(slope, degree - 1);
        while chain.degrees[chain.len - 1] > 0 {
            let (a, b) = (chain.len - 2, chain.len - 1);
            let (mut rest, db) = (chain.rows[a], chain.degrees[b]);
            let divisor = chain.rows[b];
            for k in (db..=chain.degrees[a]).rev() {
                let factor = rest[k] / divisor[db];
                for i in 0..=db {
                    rest[k - db + i] -= factor * divisor[i];
                }
                rest[k] = 0.0;
            }
            let Some(degree) = (0..db).rev().find(|&i| rest[i].abs() > 1e-14) else { break };
            for c in &mut rest {
                *c = -*c;
            }
            chain.push_scaled(rest, degree);
        }
        Some(chain)
    }

    fn push(&mut self, row: [f64; MAX], degree: usize) {
        self.rows[self.len] = row;
        self.degrees[self.len] = degree;
        self.len += 1;
    }

    fn push_scaled(&mut self, mut row: [f64; MAX], degree: usize) {
        let size = row[..=degree].iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        for c in &mut row {
            *c /= size;
        }
        self.push(row, degree);
    }

    /// Sign changes along the sequence at `x`, zeros skipped.
    fn variations(&self, x: f64) -> usize {
        let mut changes = 0;
        let mut last = 0.0_f64;
        for k in 0..self.len {
            let row = &self.rows[k][..=self.degrees[k]];
            let value = row.iter().rev().fold(0.0, |acc, c| acc * x + c);
            if value != 0.0 {
                if last * value.signum() < 0.0 {
                    changes += 1;
                }
                last = value.signum();
            }
        }
        changes
    }

    /// Fujiwara's bound on the size of all roots.
    fn root_bound(&self) -> f64 {
        let degree = self.degrees[0];
        let p = &self.rows[0];
        let lead = p[degree].abs();
        let largest = (0..degree)
            .map(|i| {
                let half = if i == 0 { 0.5 } else { 1.0 };
                (half * p[i].abs() / lead).powf(1.0 / (degree - i) as f64)
            })
            .fold(0.0_f64, f64::max);
        2.0 * largest * (1.0 + 1e-9) + 1e-12
    }

    /// The root between two positions: Newton's step where it stays inside, the middle where it does not.
    fn refine(&self, mut low: f64, mut high: f64) -> f64 {
        let p = &self.rows[0][..=self.degrees[0]];
        let rising = evaluate_with_slope(p, high).0 > evaluate_with_slope(p, low).0;
        let mut x = 0.5 * (low + high);
        for _ in 0..80 {
            let (value, slope) = evaluate_with_slope(p, x);
            if value == 0.0 {
                break;
            }
            if (value > 0.0) == rising {
                high = x;
            } else {
                low = x;
            }
            let step = x - value / slope;
            let next = if step > low && step < high { step } else { 0.5 * (low + high) };
            let done = (next - x).abs() <= 1e-15 * (1.0 + x.abs());
            x = next;
            if done {
                break;
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn agrees_with_the_eigenvalues_of_the_companion_matrix() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut compared = 0;
        for _ in 0..4000 {
            let mut p: [f64; 9] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            // The eigenvalues of an unbalanced companion matrix lose their digits when the leading coefficient is
            // small.
            p[8] += p[8].signum() * 0.3;
            let companion =
                DMatrix::from_fn(
                    8,
                    8,
                    |i, j| {
                        if j == 7 { -p[i] / p[8] } else { f64::from(u8::from(i == j + 1)) }
                    },
                );
            let eigen = companion.complex_eigenvalues();
            // For pairs of roots that are about to merge, rounding decides in either method.
            if eigen.iter().any(|z| z.im != 0.0 && z.im.abs() < 1e-5) {
                continue;
            }
            let mut expected: Vec<f64> = eigen.iter().filter(|z| z.im == 0.0).map(|z| z.re).collect();
            expected.sort_by(f64::total_cmp);
            let found = real_roots(&p);
            assert_eq!(found.len(), expected.len(), "{p:?}: {found:?} against {expected:?}");
            for (f, e) in found.iter().zip(&expected) {
                assert!((f - e).abs() < 1e-6 * (1.0 + e.abs()), "{found:?} against {expected:?}");
            }
            compared += found.len();
        }
        assert!(compared > 6000, "only {compared} roots compared");
    }

    #[test]
    fn all_eight_roots_of_a_factored_polynomial() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for _ in 0..2000 {
            let mut roots: [f64; 8] = std::array::from_fn(|_| rng.random_range(-2.0..2.0));
            roots.sort_by(f64::total_cmp);
            if roots.windows(2).any(|w| w[1] - w[0] < 0.02) {
                continue;
            }
            let mut p = [0.0; 9];
            p[0] = 1.0;
            for r in roots {
                for i in (0..9).rev() {
                    p[i] = if i > 0 { p[i - 1] } else { 0.0 } - r * p[i];
                }
            }
            let found = real_roots(&p);
            assert_eq!(found.len(), 8, "{roots:?} against {found:?}");
            for (f, e) in found.iter().zip(&roots) {
                assert!((f - e).abs() < 1e-5, "{roots:?} against {found:?}");
            }
        }
    }

    #[test]
    fn degenerate_polynomials_give_valid_roots() {
        assert!(real_roots(&[0.0; 9]).is_empty());
        assert!(real_roots(&[f64::NAN; 9]).is_empty());
        assert!(real_roots(&[3.0, 0.0, 0.0]).is_empty());
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
        assert_eq!(real_roots(&[-1.0, 1.0, 0.0, 0.0]).as_slice(), &[1.0]);
        let huge = real_roots(&[1e300, -1e300, 1e-300]);
        assert!(huge.iter().all(|x| x.is_finite()));
    }
}
