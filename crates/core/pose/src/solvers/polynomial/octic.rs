//! Real roots of a polynomial of degree eight, on the projective line and all in parallel.
//!
//! Ratios of a quaternion's components are spread evenly in angle, not in value, so the line is divided by angle: `x`
//! is used in `[−1, 1]`, and `u = 1/x` beyond, with the coefficients in reverse order. Sturm's sequence counts the
//! roots of all cells in one pass, crowded cells are halved until each root is isolated, and Halley's method, limited
//! to the bracket, refines four roots side by side: the dependent operations of one root would leave most of the
//! processor idle. [`super::real_roots`] is the plain version, and is used when the sequence is not regular.

use arrayvec::ArrayVec;

use super::sturm;

/// Borders of the cells: tangents of multiples of an eighth of a turn, from the second on.
const CUTS: [f64; 8] = [-T, -1.0, -1.0 / T, 0.0, 1.0 / T, 1.0, T, f64::MAX];

/// `tan 67.5°`.
const T: f64 = 1.0 + std::f64::consts::SQRT_2;

/// Roots refined side by side.
const LANES: usize = 4;

/// A remainder whose leading coefficient is smaller than this beside its largest has lost a degree.
const IRREGULAR: f64 = 1e-9;

/// Two roots in an interval this narrow count as one.
const NARROW: f64 = 1e-10;

/// Halley's method triples the digits: after a step this small no further step is needed.
const CONVERGED: f64 = 1e-6;

/// All real roots, in no particular order; see [`super::real_roots`] for what counts as one.
pub(crate) fn octic_roots(coefficients: &[f64; 9]) -> ArrayVec<f64, 8> {
    let Some(chain) = Chain::new(coefficients) else { return sturm::real_roots(coefficients) };
    let mut brackets = ArrayVec::new();
    chain.isolate(coefficients, &mut brackets);
    let mut roots = ArrayVec::new();
    for group in brackets.chunks(LANES) {
        let refined = refine(coefficients, group);
        for (bracket, x) in group.iter().zip(refined) {
            let root = if bracket.reversed { 1.0 / x } else { x };
            // A root at infinity is not a root of the polynomial.
            if root.is_finite() {
                let _ = roots.try_push(root);
            }
        }
    }
    roots
}

/// Sturm's sequence by its quotients: `p_{k−1} = (slope_k x + offset_k) p_k − p_{k+1}`, `p_8` being constant.
struct Chain {
    slopes: [f64; 8],
    offsets: [f64; 8],
    last: f64,
    /// Signs of the sequence at infinity: those of the leading coefficients.
    leads: [f64; 9],
}

/// An interval with one root, and the sign of the polynomial at its lower end.
#[derive(Clone, Copy)]
struct Bracket {
    low: f64,
    high: f64,
    sign: f64,
    /// In terms of `1/x`.
    reversed: bool,
}

impl Chain {
    /// `None` unless every remainder has its regular degree, by a margin.
    fn new(p: &[f64; 9]) -> Option<Self> {
        let mut chain = Self { slopes: [0.0; 8], offsets: [0.0; 8], last: 0.0, leads: [0.0; 9] };
        let mut above = *p;
        let mut below: [f64; 9] =
            std::array::from_fn(|i| if i < 8 { (i + 1) as f64 * p[i + 1] } else { 0.0 });
        (chain.leads[0], chain.leads[1]) = (p[8], below[7]);
        if !regular(&above, 8) {
            return None;
        }
        for k in 0..8 {
            // Degrees: `above` 8 − k, `below` 7 − k, remainder 6 − k.
            let degree = 7 - k;
            if !regular(&below, degree) {
                return None;
            }
            let inverse = 1.0 / below[degree];
            let slope = above[degree + 1] * inverse;
            let under = if degree > 0 { below[degree - 1] } else { 0.0 };
            let offset = (above[degree] - slope * under) * inverse;
            (chain.slopes[k], chain.offsets[k]) = (slope, offset);
            let mut rest = [0.0; 9];
            for i in 0..degree {
                let shifted = if i > 0 { below[i - 1] } else { 0.0 };
                rest[i] = slope * shifted + offset * below[i] - above[i];
            }
            if degree > 0 {
                chain.leads[k + 2] = rest[degree - 1];
            }
            (above, below) = (below, rest);
        }
        chain.last = above[0];
        chain.last.is_finite().then_some(chain)
    }

    /// Sign changes along the sequence, and the value of the polynomial, at several positions.
    #[inline]
    fn variations<const L: usize>(&self, x: &[f64; L]) -> ([u64; L], [f64; L]) {
        let mut changes = [0; L];
        let (mut next, mut value) = ([0.0; L], [self.last; L]);
        for k in (0..8).rev() {
            for l in 0..L {
                let above = (self.slopes[k] * x[l] + self.offsets[k]) * value[l] - next[l];
                changes[l] += (above.to_bits() ^ value[l].to_bits()) >> 63;
                (next[l], value[l]) = (value[l], above);
            }
        }
        (changes, value)
    }

    /// Sign changes at minus and plus infinity.
    fn variations_at_infinity(&self) -> [u64; 2] {
        let mut plus = 0;
        for pair in self.leads.windows(2) {
            plus += (pair[0].to_bits() ^ pair[1].to_bits()) >> 63;
        }
        // At minus infinity every other sign flips, so that changes and equalities are exchanged.
        [8 - plus, plus]
    }

    /// Brackets around single roots.
    fn isolate(&self, p: &[f64; 9], brackets: &mut ArrayVec<Bracket, 8>) {
        let (changes, values) = self.variations(&CUTS);
        let [first, last] = self.variations_at_infinity();
        // The outermost two cells begin and end at infinity; in terms of u = 1/x that is zero, with the sign of p[8].
        for cell in 0..8 {
            let (from, to) = (
                if cell == 0 { first } else { changes[cell - 1] },
                if cell == 7 { last } else { changes[cell] },
            );
            if from <= to {
                continue;
            }
            let reversed = !(2..6).contains(&cell);
            let at_low = if cell == 0 { p[8] } else { values[cell - 1] };
            let (low, high) = match cell {
                0 => (0.0, 1.0 / CUTS[0]),
                7 => (1.0 / CUTS[6], 0.0),
                _ if reversed => (1.0 / CUTS[cell - 1], 1.0 / CUTS[cell]),
                _ => (CUTS[cell - 1], CUTS[cell]),
            };
            let span = Span { low, high, at_low, from, to };
            self.halve(span, reversed, brackets);
        }
    }

    /// Halves a cell until every root in it is isolated.
    fn halve(&self, cell: Span, reversed: bool, brackets: &mut ArrayVec<Bracket, 8>) {
        let mut stack: ArrayVec<Span, 64> = ArrayVec::new();
        stack.push(cell);
        while let Some(span) = stack.pop() {
            let Span { low, high, at_low, from, to } = span;
            if from <= to {
                continue;
            }
            if from - to == 1 || (high - low).abs() < NARROW || stack.remaining_capacity() < 2 {
                let _ = brackets.try_push(Bracket { low, high, sign: at_low, reversed });
                continue;
            }
            let middle = 0.5 * (low + high);
            let ([between], [value]) = self.variations(&[if reversed { 1.0 / middle } else { middle }]);
            stack.push(Span { low: middle, high, at_low: value, from: between, to });
            stack.push(Span { low, high: middle, at_low, from, to: between });
        }
    }
}

/// From `low` to `high` the sign changes fall from `from` to `to`.
#[derive(Clone, Copy)]
struct Span {
    low: f64,
    high: f64,
    at_low: f64,
    from: u64,
    to: u64,
}

fn regular(p: &[f64; 9], degree: usize) -> bool {
    let size = p[..degree].iter().fold(0.0, |m: f64, c| if c.abs() > m { c.abs() } else { m });
    // NaN and zero fail.
    p[degree].abs() > IRREGULAR * size
}

/// The roots of up to four brackets, each in its own chart.
fn refine(p: &[f64; 9], brackets: &[Bracket]) -> [f64; LANES] {
    // Idle lanes repeat the first bracket.
    let lane: [Bracket; LANES] = std::array::from_fn(|l| brackets[if l < brackets.len() { l } else { 0 }]);
    let c: [[f64; LANES]; 9] =
        std::array::from_fn(|i| std::array::from_fn(|l| p[if lane[l].reversed { 8 - i } else { i }]));
    // Below: where the sign is that of the lower end.
    let (mut below, mut beyond) = (lane.map(|b| b.low), lane.map(|b| b.high));
    let sign = lane.map(|b| b.sign);
    let mut x: [f64; LANES] = std::array::from_fn(|l| 0.5 * (below[l] + beyond[l]));
    for _ in 0..60 {
        let (mut value, mut slope, mut bend) = (c[8], [0.0; LANES], [0.0; LANES]);
        for row in c[..8].iter().rev() {
            for l in 0..LANES {
                bend[l] = bend[l] * x[l] + slope[l];
                slope[l] = slope[l] * x[l] + value[l];
                value[l] = value[l] * x[l] + row[l];
            }
        }
        let mut longest = 0.0;
        for l in 0..LANES {
            if value[l] * sign[l] > 0.0 {
                below[l] = x[l];
            } else {
                beyond[l] = x[l];
            }
            let next = x[l] - value[l] * slope[l] / (slope[l] * slope[l] - value[l] * bend[l]);
            // Between the ends, in either order.
            let inside = (next - below[l]) * (next - beyond[l]) <= 0.0;
            let next = if inside { next } else { 0.5 * (below[l] + beyond[l]) };
            let step = (next - x[l]).abs();
            longest = if step > longest { step } else { longest };
            x[l] = next;
        }
        if longest < CONVERGED {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn sorted(mut roots: ArrayVec<f64, 8>) -> ArrayVec<f64, 8> {
        roots.sort_by(f64::total_cmp);
        roots
    }

    #[test]
    fn octic_agrees_with_sturm() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut compared, mut differ, total) = (0, 0, 20_000);
        for _ in 0..total {
            let p: [f64; 9] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let (fast, slow) = (sorted(octic_roots(&p)), sturm::real_roots(&p));
            let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9 * (1.0 + a * a);
            differ += usize::from(fast.len() != slow.len() || !fast.iter().zip(&slow).all(near));
            compared += slow.len();
        }
        assert!(compared > total, "only {compared} roots");
        // For pairs that are about to merge, rounding decides in either method.
        assert!(differ * 2000 <= total, "{differ} of {total}");
    }

    #[test]
    fn all_roots_of_a_factored_polynomial_wherever_they_are() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..5000 {
            // Evenly in angle: half of them beyond one, some very far from zero.
            let mut angles: [f64; 8] = std::array::from_fn(|_| rng.random_range(-1.57..1.57));
            angles.sort_by(f64::total_cmp);
            if angles.windows(2).any(|w| w[1] - w[0] < 0.03) {
                continue;
            }
            let mut p = [0.0; 9];
            p[0] = 1.0;
            for angle in angles {
                let (sin, cos) = angle.sin_cos();
                for i in (0..9).rev() {
                    p[i] = cos * if i > 0 { p[i - 1] } else { 0.0 } - sin * p[i];
                }
            }
            let found = sorted(octic_roots(&p));
            assert_eq!(found.len(), 8, "{angles:?} against {found:?}");
            for (f, angle) in found.iter().zip(&angles) {
                assert!((f.atan() - angle).abs() < 1e-6, "{angles:?} against {found:?}");
            }
        }
    }

    #[test]
    fn irregular_polynomials_fall_back_to_sturm() {
        for p in [
            [0.0; 9],
            [f64::NAN; 9],
            [f64::INFINITY; 9],
            [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [-1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [1e300, -1e300, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1e-300],
        ] {
            assert_eq!(sorted(octic_roots(&p)), sturm::real_roots(&p), "{p:?}");
        }
    }
}
