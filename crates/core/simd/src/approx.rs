//! Logarithm, exponential and angle functions with equal results on every machine; the compiler can vectorize most of
//! them.

/// Natural logarithm of a positive normal number, to about 1e-5; about −88 for zero, finite for all other inputs.
///
/// Exponent from the bits, mantissa by a polynomial of degree five that is exact at 1 (continuous between octaves).
/// Scores need no more precision: an inlier adds about five.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    let p = ((((-0.034_436_006 * m + 0.318_213_37) * m - 1.231_530_3) * m + 2.598_845_2) * m - 3.324_199) * m
        + 3.115_79;
    (exponent as f32 + p * (m - 1.0)) * std::f32::consts::LN_2
}

/// Exponential of a number between −80 and 0, to about 1e-6 of its value; other inputs are clamped.
///
/// Power of two from the integer part, a polynomial of degree six for the rest.
#[inline(always)]
pub(crate) fn exp_of_negative(x: f32) -> f32 {
    // NaN becomes the lower end.
    let x = if x > -80.0 { x } else { -80.0 };
    let x = if x < 0.0 { x } else { 0.0 };
    let scaled = x * std::f32::consts::LOG2_E;
    // Adding 1.5 · 2²³ rounds to the nearest integer, which is then in the low bits.
    let shifted = scaled + 12_582_912.0;
    let whole = shifted - 12_582_912.0;
    let r = (scaled - whole) * std::f32::consts::LN_2;
    let p = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r / 720.0)))));
    let power = f32::from_bits(((whole as i32 + 127) << 23) as u32);
    p * power
}

/// Angle of `(x, y)` from the `x` axis in `[−π, π]`, to about 1e-5; a finite number or NaN where it is undefined.
///
/// Polynomial of degree eleven for the octant, the rest by symmetry.
#[inline(always)]
pub(crate) fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ay > ax;
    let t = if steep { ax / ay } else { ay / ax };
    let s = t * t;
    let p = (((((-0.011_721_2 * s + 0.052_653_32) * s - 0.116_432_87) * s + 0.193_543_46) * s
        - 0.332_623_47)
        * s
        + 0.999_977_26)
        * t;
    let p = if steep { std::f32::consts::FRAC_PI_2 - p } else { p };
    let p = if x < 0.0 { std::f32::consts::PI - p } else { p };
    if y < 0.0 { -p } else { p }
}

/// Two to the power of a number, accurate to a few units in the last place, if the result is neither infinite nor
/// subnormal.
pub fn exp2(x: f64) -> f64 {
    let whole = x.round();
    let r = (x - whole) * std::f64::consts::LN_2;
    // The series of e^r, for |r| below 0.35.
    let series = (1..=15).rev().fold(1.0, |sum, k| 1.0 + sum * r / f64::from(k));
    series * f64::from_bits(((whole as i64 + 1023) << 52) as u64)
}

/// Cosine and sine of an angle within a few turns, to about 1e-7.
pub(crate) fn cos_sin(angle: f32) -> [f32; 2] {
    let angle = f64::from(angle);
    let quarters = (angle * std::f64::consts::FRAC_2_PI).round();
    let r = angle - quarters * std::f64::consts::FRAC_PI_2;
    let s = r * r;
    let cos = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0)));
    let sin = r * (1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0))));
    let [cos, sin] = match (quarters as i64).rem_euclid(4) {
        0 => [cos, sin],
        1 => [-sin, cos],
        2 => [-cos, -sin],
        _ => [sin, -cos],
    };
    [cos as f32, sin as f32]
}

/// Difference of a number to the nearest integer, for numbers below a million.
#[inline(always)]
pub(crate) fn from_nearest_integer(x: f32) -> f32 {
    // Adding 1.5 · 2²³ rounds to the nearest integer.
    x - ((x + 12_582_912.0) - 12_582_912.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ln_agrees_with_the_library() {
        let mut x = 1e-30_f32;
        while x < 1e30 {
            assert!((ln(x) - x.ln()).abs() < 3e-5, "{x}: {} against {}", ln(x), x.ln());
            x *= 1.0007;
        }
        assert!(ln(0.0) < -80.0 && ln(0.0).is_finite());
    }

    #[test]
    fn atan2_agrees_with_the_library() {
        for i in 0..20_000 {
            let angle = (i as f32 * 0.000_31) - 3.1;
            for radius in [1e-3, 1.0, 700.0] {
                let (y, x) = (angle.sin() * radius, angle.cos() * radius);
                assert!((atan2(y, x) - y.atan2(x)).abs() < 2e-5, "{y} {x}");
            }
        }
        for (x, beside) in [(2.25, 0.25), (-3.75, 0.25), (0.4, 0.4), (7.6, -0.4)] {
            assert!((from_nearest_integer(x) - beside).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn exp2_and_cos_sin_agree_with_the_library() {
        for i in -4000..4000 {
            let x = f64::from(i) * 0.0137;
            assert!((exp2(x) / x.exp2() - 1.0).abs() < 1e-15, "{x}");
            let angle = x as f32;
            let [cos, sin] = cos_sin(angle);
            assert!((cos - angle.cos()).abs() < 2e-7 && (sin - angle.sin()).abs() < 2e-7, "{angle}");
        }
        assert_eq!((exp2(0.0), exp2(3.0), exp2(-2.0)), (1.0, 8.0, 0.25));
    }

    #[test]
    fn exp_agrees_with_the_library() {
        let mut x = 0.0_f32;
        while x > -79.0 {
            let (found, expected) = (f64::from(exp_of_negative(x)), f64::from(x).exp());
            // The argument itself is rounded: relative 6e-8 of 80.
            assert!((found / expected - 1.0).abs() < 1e-5, "{x}: {found} against {expected}");
            x -= 0.0137;
        }
        for x in [f32::NAN, f32::NEG_INFINITY, -1e30] {
            assert!(exp_of_negative(x) < 1e-34 && exp_of_negative(x) > 0.0, "{x}");
        }
        assert_eq!(exp_of_negative(3.0), 1.0);
    }
}
