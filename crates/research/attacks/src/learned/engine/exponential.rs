//! The exponential and the softmax, written so that the compiler works on several numbers at once.

/// Below this the exponential is taken to be that of this.
const LEAST: f32 = -87.0;
/// Added and taken off, rounds to a whole number: 1.5 · 2²³.
const ROUNDING: f32 = 12_582_912.0;
/// ln 2 in two parts, the first with few digits, so that its product with a whole number is exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];

/// `eˣ` for `x ≤ 0`, to three parts in ten million: `2ⁿ eʳ` with `|r| ≤ ½ ln 2`.
#[inline]
pub(crate) fn exponential(x: f32) -> f32 {
    let x = x.max(LEAST);
    let shifted = x * std::f32::consts::LOG2_E + ROUNDING;
    let n = shifted - ROUNDING;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let series =
        1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r / 720.0)))));
    // The low bits of `shifted` hold n; moved to where the exponent stands.
    let power = f32::from_bits(shifted.to_bits().wrapping_add(127) << 23);
    series * power
}

/// Numbers that sum to one, in place of their logarithms up to one constant; returns the logarithm of their sum before.
pub(crate) fn softmax(x: &mut [f32]) -> f32 {
    let most = x.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if most == f32::NEG_INFINITY {
        x.fill(0.0);
        return most;
    }
    for v in x.iter_mut() {
        *v = exponential(*v - most);
    }
    // Eight sums side by side: fast, and the same on every machine.
    let mut sums = [0.0f32; 8];
    for part in x.chunks(8) {
        for (s, v) in sums.iter_mut().zip(part) {
            *s += v;
        }
    }
    let sum: f32 = sums.iter().sum();
    let factor = 1.0 / sum;
    for v in x.iter_mut() {
        *v *= factor;
    }
    most + sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_exponential() {
        let mut x = 0.0f32;
        while x > -80.0 {
            let (told, known) = (f64::from(exponential(x)), f64::from(x).exp());
            assert!((told / known - 1.0).abs() < 4e-7, "{x}: {told} {known}");
            x -= 0.0137;
        }
        assert_eq!(exponential(0.0), 1.0);
        assert!(exponential(-1e30) < 1e-37 && exponential(f32::NEG_INFINITY) >= 0.0);
    }

    #[test]
    fn softmax_sums_to_one_and_tells_the_sum() {
        let mut x: Vec<f32> = (0..13).map(|i| (i as f32 * 0.7).sin() * 9.0).collect();
        let sum: f64 = x.iter().map(|v| f64::from(*v).exp()).sum();
        let before = x.clone();
        let told = softmax(&mut x);
        assert!((f64::from(told) - sum.ln()).abs() < 1e-5);
        for (share, v) in x.iter().zip(&before) {
            assert!((f64::from(*share) - f64::from(*v).exp() / sum).abs() < 1e-6);
        }
    }
}
