//! Real roots of polynomials by Sturm's sequence: of any degree up to eight, and a faster version for eight.
//!
//! Coefficients are given constant term first, `p(x) = c[0] + c[1] x + … + c[N-1] xᴺ⁻¹`. Roots are returned in rising
//! order. A polynomial that is zero, or contains a number that is not finite, has no roots here. Leading coefficients
//! that are only rounding errors lower the degree instead of producing roots near infinity.

mod octic;
mod sturm;

pub(crate) use octic::octic_roots;
pub use sturm::real_roots;

/// Value of the polynomial by Horner's rule.
pub fn evaluate<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |acc, c| acc * x + c)
}

/// Value and first derivative.
pub(crate) fn evaluate_with_slope(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients.iter().rev().fold((0.0, 0.0), |(p, d), c| (p * x + c, d * x + p))
}

/// Product of two polynomials; `C` must be `A + B - 1`.
pub(crate) fn product<const A: usize, const B: usize, const C: usize>(
    a: &[f64; A],
    b: &[f64; B],
) -> [f64; C] {
    const { assert!(A + B == C + 1, "degree of a product is the sum of degrees") };
    let mut out = [0.0; C];
    for i in 0..A {
        for j in 0..B {
            out[i + j] += a[i] * b[j];
        }
    }
    out
}

/// `a + s b`.
pub(crate) fn add_scaled<const N: usize>(a: &[f64; N], s: f64, b: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] + s * b[i])
}
