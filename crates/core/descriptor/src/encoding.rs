//! The numbers that the bytes of a descriptor represent.

/// Representation of the numbers of a descriptor, one byte each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// 0 to 255, unchanged.
    Unsigned,
    /// -128 to 127, stored as the value plus 128 (offset binary). The offset cancels in differences, so Euclidean
    /// distances, nearest neighbours, means and residuals are computed on the bytes as for [`Encoding::Unsigned`];
    /// functions of a single vector (lengths, cosines) must subtract it first: [`Encoding::value`].
    Signed,
    /// Sixteen steps of -120 to 120, stored like [`Encoding::Signed`]; 4 bits each in messages, see
    /// [`DescriptorKind::packed_len`](crate::DescriptorKind::packed_len). Values computed from rows, for example words
    /// of a vocabulary, may lie between the steps.
    Coarse,
}

impl Encoding {
    /// The byte of the number 0.
    pub const fn zero(self) -> u8 {
        match self {
            Self::Unsigned => 0,
            Self::Signed | Self::Coarse => 128,
        }
    }

    /// The number that a byte represents.
    pub const fn value(self, byte: u8) -> i16 {
        byte as i16 - self.zero() as i16
    }

    /// The byte of a number, rounded to the nearest representable one; NaN counts as 0.
    pub fn byte(self, value: f64) -> u8 {
        let value = if value.is_nan() { 0.0 } else { value };
        let value = (value + f64::from(self.zero())).clamp(0.0, 255.0);
        match self {
            Self::Unsigned | Self::Signed => value.round() as u8,
            Self::Coarse => coarse(value as u8 >> 4),
        }
    }

    /// The largest magnitude of a number.
    pub const fn max_magnitude(self) -> u16 {
        match self {
            Self::Unsigned => 255,
            Self::Signed => 128,
            Self::Coarse => 120,
        }
    }

    /// Bits of a number in messages.
    pub const fn bits(self) -> u32 {
        match self {
            Self::Unsigned | Self::Signed => 8,
            Self::Coarse => 4,
        }
    }

    pub(crate) const fn code(self) -> u8 {
        match self {
            Self::Unsigned => 0,
            Self::Signed => 1,
            Self::Coarse => 2,
        }
    }

    pub(crate) const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Unsigned),
            1 => Some(Self::Signed),
            2 => Some(Self::Coarse),
            _ => None,
        }
    }
}

/// The byte in the middle of a step, 0 to 15.
pub(crate) const fn coarse(step: u8) -> u8 {
    step << 4 | 8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_numbers() {
        for encoding in [Encoding::Unsigned, Encoding::Signed] {
            assert_eq!(Encoding::from_code(encoding.code()), Some(encoding));
            assert_eq!(encoding.value(encoding.zero()), 0);
            for byte in 0..=255 {
                assert_eq!(encoding.byte(f64::from(encoding.value(byte))), byte);
            }
            assert_eq!(encoding.byte(f64::NAN), encoding.zero());
            assert_eq!((encoding.byte(-1e9), encoding.byte(1e9)), (0, 255));
        }
        assert_eq!(Encoding::Signed.byte(-128.0), 0);
        assert_eq!(Encoding::from_code(3), None);
    }

    #[test]
    fn coarse_numbers_are_rounded_to_sixteen_steps() {
        let encoding = Encoding::Coarse;
        assert_eq!(Encoding::from_code(encoding.code()), Some(encoding));
        let steps: Vec<i16> = (0..16).map(|step| encoding.value(coarse(step))).collect();
        assert_eq!((steps[0], steps[7], steps[8], steps[15]), (-120, -8, 8, 120));
        for value in -560..=560 {
            let value = f64::from(value) / 4.0 + 0.1;
            let found = f64::from(encoding.value(encoding.byte(value)));
            let nearest = steps.iter().map(|s| (f64::from(*s) - value).abs()).fold(f64::INFINITY, f64::min);
            assert!(((found - value).abs() - nearest).abs() < 1e-9, "{value}: {found}");
        }
        assert!(steps.contains(&encoding.value(encoding.byte(f64::NAN))));
        assert_eq!(encoding.max_magnitude(), 120);
    }
}
