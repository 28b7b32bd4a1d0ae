//! Half-precision numbers (IEEE 754 binary16) as bits; stable Rust has no such type.

use half::f16;

/// Converts bits to a number; exact.
pub(crate) fn from_bits(bits: u16) -> f32 {
    f16::from_bits(bits).to_f32()
}

/// Rounds to the nearest half-precision number, ties to even; infinite on overflow.
pub(crate) fn to_bits(value: f32) -> u16 {
    f16::from_f32(value).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_round_trips() {
        for bits in 0..=u16::MAX {
            let value = from_bits(bits);
            if value.is_nan() {
                assert!(from_bits(to_bits(value)).is_nan(), "{bits:#x}");
            } else {
                assert_eq!(to_bits(value), bits, "{value}");
            }
        }
    }

    #[test]
    fn known_numbers_and_halfway_cases() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 2.0_f32.powi(-24)),
            (0x03ff, 1023.0 / 16_777_216.0),
            (0x0400, 2.0_f32.powi(-14)),
            (0x3555, 0.333_251_95),
        ] {
            assert_eq!(from_bits(bits), value);
            assert_eq!(to_bits(value), bits);
        }
        // The midpoint between 1 and the next number, 1 + 2^-10, rounds to the even one.
        assert_eq!(to_bits(1.0 + 2.0_f32.powi(-11)), 0x3c00);
        assert_eq!(to_bits(1.0 + 3.0 * 2.0_f32.powi(-11)), 0x3c02);
        assert_eq!(to_bits(1.0 + 2.0_f32.powi(-11) + 2.0_f32.powi(-20)), 0x3c01);
        assert_eq!(to_bits(65519.9), 0x7bff);
        assert_eq!(to_bits(65520.0), 0x7c00);
        assert_eq!(to_bits(1e10), 0x7c00);
        assert_eq!(to_bits(f32::NEG_INFINITY), 0xfc00);
        assert_eq!(to_bits(-0.0), 0x8000);
    }
}
