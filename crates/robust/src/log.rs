//! A logarithm that the compiler can turn into vector instructions, the same on every machine.

/// Natural logarithm of a positive normal number, to about 1e-5; anything else gives a finite number or so.
///
/// Exponent from the bits, mantissa by a polynomial of degree five that is exact at 1 (so nothing jumps between
/// octaves). The score needs no more: a whole inlier is worth about five.
#[inline(always)]
pub(crate) fn ln_approx(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    let p = ((((-0.034_436_006 * m + 0.318_213_37) * m - 1.231_530_3) * m + 2.598_845_2) * m - 3.324_199) * m
        + 3.115_79;
    (exponent as f32 + p * (m - 1.0)) * std::f32::consts::LN_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_library() {
        let mut x = 1e-6_f32;
        while x < 1e8 {
            assert!((ln_approx(x) - x.ln()).abs() < 3e-5, "{x}: {} against {}", ln_approx(x), x.ln());
            x *= 1.0007;
        }
    }
}
