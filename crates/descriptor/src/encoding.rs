//! What number a byte of a descriptor stands for.

/// How the numbers of a descriptor are kept, one byte each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// 0 to 255, as they are.
    Unsigned,
    /// -128 to 127, kept as the value plus 128 (offset binary). The offset cancels in differences, so Euclidean
    /// distances, nearest neighbours, means and residuals are computed on the bytes as for [`Encoding::Unsigned`];
    /// whatever looks at one vector alone (lengths, cosines) must take it off first: [`Encoding::value`].
    Signed,
}

impl Encoding {
    /// The byte of the number 0.
    pub const fn zero(self) -> u8 {
        match self {
            Self::Unsigned => 0,
            Self::Signed => 128,
        }
    }

    /// The number a byte stands for.
    pub const fn value(self, byte: u8) -> i16 {
        byte as i16 - self.zero() as i16
    }

    /// The byte of a number, rounded to the nearest that there is; not a number counts as 0.
    pub fn byte(self, value: f64) -> u8 {
        let value = if value.is_nan() { 0.0 } else { value };
        (value + f64::from(self.zero())).round().clamp(0.0, 255.0) as u8
    }

    /// The largest magnitude of a number.
    pub const fn max_magnitude(self) -> u16 {
        match self {
            Self::Unsigned => 255,
            Self::Signed => 128,
        }
    }

    pub(crate) const fn code(self) -> u8 {
        match self {
            Self::Unsigned => 0,
            Self::Signed => 1,
        }
    }

    pub(crate) const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Unsigned),
            1 => Some(Self::Signed),
            _ => None,
        }
    }
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
        assert_eq!(Encoding::from_code(2), None);
    }
}
