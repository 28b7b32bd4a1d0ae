//! Where Dual Convergent Lines puts its dividing line and anchors, in numbers both sides read alike.

use std::f64::consts::PI;

use veiloc_geometry::DualAnchors;

use crate::QueryError;

/// Dividing line and anchor distance of Dual Convergent Lines.
///
/// Stored as small whole numbers, hundredths of a degree and hundredths of half the image's height, so that
/// device and server compute with exactly the same anchors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct DclLayout {
    /// Direction of the dividing line from the `u` axis towards `v`, 1/100 degree, `0..18000`.
    angle_code: u16,
    /// `s`, 1/100, from 10 to 2000.
    distance_code: u16,
}

impl DclLayout {
    /// The paper's default: vertical midline, anchors in the middle of the top and bottom edge (`s = 1`).
    pub const VERTICAL: Self = Self { angle_code: Self::QUARTER_TURN, distance_code: 100 };
    /// Horizontal midline, `s = 1`: the first anchor to the left of the centre serves the lower half.
    pub const HORIZONTAL: Self = Self { angle_code: 0, distance_code: 100 };

    const QUARTER_TURN: u16 = 9_000;
    const HALF_TURN: u16 = 18_000;
    const DISTANCES: std::ops::RangeInclusive<u16> = 10..=2_000;

    /// A dividing line through the centre at `degrees` from the `u` axis towards `v` (90 is vertical), in
    /// `[0, 180)`, and anchors `s·H/2` from the centre, `s` from 0.1 to 20. Both are rounded to hundredths.
    ///
    /// # Errors
    /// [`QueryError::Layout`] for other numbers.
    pub fn new(degrees: f64, s: f64) -> Result<Self, QueryError> {
        let refuse = || QueryError::Layout { degrees, s };
        if !(degrees.is_finite() && s.is_finite() && (0.0..180.0).contains(&degrees) && s <= 21.0 && s > 0.0)
        {
            return Err(refuse());
        }
        let angle = (degrees * 100.0).round() as u16;
        Self::from_codes((angle % Self::HALF_TURN).into(), ((s * 100.0).round() as u16).into())
            .map_err(|_| refuse())
    }

    /// From the numbers on the wire.
    ///
    /// # Errors
    /// [`QueryError::Field`] for a number out of range.
    pub fn from_codes(angle: u32, distance: u32) -> Result<Self, QueryError> {
        let angle_code =
            u16::try_from(angle).ok().filter(|a| *a < Self::HALF_TURN).ok_or(QueryError::Field {
                field: "dividing_angle",
                value: angle,
                allowed: "a number below 18000",
            })?;
        let distance_code = u16::try_from(distance).ok().filter(|s| Self::DISTANCES.contains(s)).ok_or(
            QueryError::Field {
                field: "anchor_distance",
                value: distance,
                allowed: "a number from 10 to 2000",
            },
        )?;
        Ok(Self { angle_code, distance_code })
    }

    /// `(angle, distance)` as on the wire: 1/100 degree, and `s` in 1/100.
    pub const fn codes(self) -> (u32, u32) {
        (self.angle_code as u32, self.distance_code as u32)
    }

    /// Direction of the dividing line, degrees from the `u` axis towards `v`, in `[0, 180)`.
    pub fn degrees(self) -> f64 {
        f64::from(self.angle_code) / 100.0
    }

    /// Distance of the anchors from the centre in half image heights.
    pub fn s(self) -> f64 {
        f64::from(self.distance_code) / 100.0
    }

    /// The anchors for an image of this size.
    pub fn anchors(self, width: u32, height: u32) -> DualAnchors {
        let angle = PI * (f64::from(self.angle_code) / f64::from(Self::HALF_TURN));
        DualAnchors::new(width, height, angle, self.s())
            .expect("both codes are in range, so s > 0 and finite")
    }
}

/// [`DclLayout::VERTICAL`].
impl Default for DclLayout {
    fn default() -> Self {
        Self::VERTICAL
    }
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::{Anchor, Pixel};

    use super::*;

    #[test]
    fn anchors_of_the_named_layouts() {
        assert_eq!(DclLayout::VERTICAL.anchors(640, 480), DualAnchors::vertical(640, 480));
        let horizontal = DclLayout::HORIZONTAL.anchors(640, 480);
        assert_eq!(horizontal.position(Anchor::First), Pixel::new(80.0, 240.0));
        assert_eq!(horizontal.position(Anchor::Second), Pixel::new(560.0, 240.0));
        assert_eq!(horizontal.anchor_of(Pixel::new(10.0, 470.0)), Anchor::First);
    }

    #[test]
    fn numbers_are_rounded_once_and_kept() {
        let layout = DclLayout::new(30.004, 2.0).expect("allowed");
        assert_eq!((layout.degrees(), layout.s()), (30.0, 2.0));
        assert_eq!(DclLayout::new(179.999, 1.0).expect("allowed"), DclLayout::HORIZONTAL);
        assert_eq!(DclLayout::new(90.0, 1.0).expect("allowed"), DclLayout::default());
        for (degrees, s) in
            [(180.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0), (90.0, 0.0), (90.0, 21.0), (90.0, f64::INFINITY)]
        {
            assert!(DclLayout::new(degrees, s).is_err(), "{degrees} {s}");
        }
    }
}
