//! Angles as small codes (rule L2).

use std::f64::consts::{PI, TAU};

use crate::QueryError;

/// How many bits an angle over the half circle has on the wire: 6 to 16. An angle over the full circle, as in `dcl`,
/// has one more.
///
/// A code stands for the middle of its interval: `angle = (code + 1/2) · π / 2^bits`. Fewer bits map more pixels to the
/// same line and reduce the accuracy of the pose; the error of 12 bits is at most 0.0004 rad, a fifth of a pixel at 500
/// pixels from the anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct AngleBits(u8);

impl AngleBits {
    /// Fewest bits.
    pub const MIN: u8 = 6;
    /// Most bits.
    pub const MAX: u8 = 16;

    /// A number of bits from [`Self::MIN`] to [`Self::MAX`].
    ///
    /// # Errors
    /// [`QueryError::Field`] for any other number.
    pub const fn new(bits: u8) -> Result<Self, QueryError> {
        if bits < Self::MIN || bits > Self::MAX {
            return Err(QueryError::Field {
                field: "angle_bits",
                value: bits as u32,
                allowed: "a number from 6 to 16",
            });
        }
        Ok(Self(bits))
    }

    pub(crate) fn from_wire(bits: u32) -> Result<Self, QueryError> {
        Self::new(u8::try_from(bits).unwrap_or(u8::MAX)).map_err(|_| QueryError::Field {
            field: "angle_bits",
            value: bits,
            allowed: "a number from 6 to 16",
        })
    }

    /// The number of bits.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The number of codes, `2^bits`.
    pub const fn levels(self) -> u32 {
        1 << self.0
    }

    /// The code of an angle in `[0, π]`, radians; angles outside of it are clamped.
    pub fn code_of(self, angle: f64) -> u16 {
        let levels = f64::from(self.levels());
        (angle / PI * levels).floor().clamp(0.0, levels - 1.0) as u16
    }

    /// The number of codes of the full circle.
    pub const fn levels_of_circle(self) -> u32 {
        2 << self.0
    }

    /// The code over the full circle of an angle, radians, any number of turns.
    pub fn code_on_circle(self, angle: f64) -> u32 {
        let levels = f64::from(self.levels_of_circle());
        (angle.rem_euclid(TAU) / TAU * levels).floor().clamp(0.0, levels - 1.0) as u32
    }

    /// The angle in the middle of the interval of a full-circle code, radians in `(0, 2π)`.
    pub fn angle_on_circle(self, code: u32) -> f64 {
        (f64::from(code) + 0.5) * TAU / f64::from(self.levels_of_circle())
    }

    /// The angle in the middle of the interval of a code, radians in `(0, π)`.
    pub fn angle_of(self, code: u16) -> f64 {
        (f64::from(code) + 0.5) * PI / f64::from(self.levels())
    }
}

/// 12 bits.
impl Default for AngleBits {
    fn default() -> Self {
        Self(12)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_round_trip_and_cover_the_half_circle() {
        for bits in AngleBits::MIN..=AngleBits::MAX {
            let bits = AngleBits::new(bits).expect("allowed");
            for code in (0..bits.levels()).step_by(7).chain([bits.levels() - 1]) {
                assert_eq!(u32::from(bits.code_of(bits.angle_of(code as u16))), code);
            }
            let half_step = PI / f64::from(bits.levels()) / 2.0;
            for i in 0..=1000 {
                let angle = PI * f64::from(i) / 1000.0;
                assert!((bits.angle_of(bits.code_of(angle)) - angle).abs() <= half_step * (1.0 + 1e-9));
            }
        }
    }

    #[test]
    fn codes_of_the_circle_round_trip_and_wrap() {
        for bits in AngleBits::MIN..=AngleBits::MAX {
            let bits = AngleBits::new(bits).expect("allowed");
            let levels = bits.levels_of_circle();
            for code in (0..levels).step_by(7).chain([levels - 1]) {
                let angle = bits.angle_on_circle(code);
                assert_eq!([angle, angle + TAU, angle - TAU].map(|a| bits.code_on_circle(a)), [code; 3]);
            }
            assert_eq!(bits.code_on_circle(-1e-300), levels - 1);
        }
    }

    #[test]
    fn invalid_bit_counts_are_rejected() {
        for bits in [0, 5, 17, 255] {
            assert!(AngleBits::new(bits).is_err());
        }
    }
}
