//! The anchors and sectors of Dual Convergent Lines, as numbers that device and server read alike.

use std::f64::consts::PI;

use veiloc_geometry::nalgebra::Rotation3;
use veiloc_geometry::{Layout, Pencils, Pinhole};

use crate::sector_layout::SectorLayout;
use crate::{LayoutTurn, QueryError};

/// A layout of Dual Convergent Lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DclLayout {
    /// Two halves: the paper's.
    Halves(HalvesLayout),
    /// Sectors and two to four anchors anywhere.
    Sectors(SectorLayout),
    /// The paper's anchors, one of them at random for each keypoint. Only for tables of attacks: no device seals with it,
    /// and no query can carry it.
    Random,
}

/// Dividing line and anchor distance of two halves.
///
/// Stored as small integers, hundredths of a degree and hundredths of half the image's height, so that device and
/// server compute with exactly the same anchors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HalvesLayout {
    /// Direction of the dividing line from the `u` axis towards `v`, 1/100 degree, `0..18000`.
    angle_code: u16,
    /// `s`, 1/100, from 10 to 2000.
    distance_code: u16,
}

impl HalvesLayout {
    const QUARTER_TURN: u16 = 9_000;
    const HALF_TURN: u16 = 18_000;
    const DISTANCES: std::ops::RangeInclusive<u16> = 10..=2_000;

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

    fn radians(self) -> f64 {
        PI * (f64::from(self.angle_code) / f64::from(Self::HALF_TURN))
    }
}

impl DclLayout {
    /// The default: slanted strips ([`SectorLayout::SLANTED`]).
    pub const DEFAULT: Self = Self::Sectors(SectorLayout::SLANTED);
    /// The paper's: vertical midline, anchors in the middle of the top and bottom edge (`s = 1`).
    pub const VERTICAL: Self =
        Self::Halves(HalvesLayout { angle_code: HalvesLayout::QUARTER_TURN, distance_code: 100 });
    /// Horizontal midline, `s = 1`: the first anchor to the left of the centre serves the lower half.
    pub const HORIZONTAL: Self = Self::Halves(HalvesLayout { angle_code: 0, distance_code: 100 });

    /// Two halves: a dividing line through the centre at `degrees` from the `u` axis towards `v` (90 is vertical), in
    /// `[0, 180)`, and anchors `s·H/2` from the centre, `s` from 0.1 to 20. Both are rounded to hundredths.
    ///
    /// # Errors
    /// [`QueryError::Layout`] for other numbers.
    pub fn halves(degrees: f64, s: f64) -> Result<Self, QueryError> {
        let refuse = || QueryError::Layout { degrees, s };
        if !(degrees.is_finite() && s.is_finite() && (0.0..180.0).contains(&degrees) && s <= 21.0 && s > 0.0)
        {
            return Err(refuse());
        }
        let angle = (degrees * 100.0).round() as u16;
        HalvesLayout::from_codes(
            (angle % HalvesLayout::HALF_TURN).into(),
            ((s * 100.0).round() as u16).into(),
        )
        .map(Self::Halves)
        .map_err(|_| refuse())
    }

    /// How many anchors there are.
    pub const fn anchors(&self) -> usize {
        match self {
            Self::Halves(_) | Self::Random => 2,
            Self::Sectors(sectors) => sectors.anchors(),
        }
    }

    /// Anchors and sectors as real numbers.
    pub fn layout(self) -> Layout {
        match self {
            Self::Halves(halves) => {
                Layout::halves(halves.radians(), halves.s()).expect("both codes are in range")
            }
            Self::Sectors(sectors) => sectors.layout(),
            Self::Random => Self::VERTICAL.layout().with_random_assignment(),
        }
    }

    /// Its pencils in an image of this camera, whose principal point is assumed to be the image's centre; `None` unless
    /// size and focal length are positive.
    pub fn pencils(self, camera: &Pinhole, turn: LayoutTurn) -> Option<Pencils> {
        let size = [camera.width, camera.height];
        let turn: Rotation3<f64> = turn.cam_from_layout();
        Pencils::new(size, camera.mean_focal(), &self.layout(), &turn)
    }
}

/// [`DclLayout::DEFAULT`].
impl Default for DclLayout {
    fn default() -> Self {
        Self::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::{Anchor, Pixel};

    use super::*;

    #[test]
    fn anchors_of_the_named_layouts() {
        let pencils = |layout: DclLayout| Pencils::of_image([640, 480], &layout.layout());
        assert_eq!(pencils(DclLayout::VERTICAL), Pencils::paper(640, 480));
        for (layout, anchors, pixels_of_first, pixels_of_second) in [
            (
                DclLayout::VERTICAL,
                [(320.0, 0.0), (320.0, 480.0)],
                [(10.0, 300.0), (320.0, 123.0)],
                [(600.0, 300.0), (321.0, 470.0)],
            ),
            (
                DclLayout::HORIZONTAL,
                [(80.0, 240.0), (560.0, 240.0)],
                [(10.0, 470.0), (630.0, 241.0)],
                [(10.0, 10.0), (320.0, 239.0)],
            ),
        ] {
            let pencils = pencils(layout);
            for (anchor, (u, v)) in Anchor::BOTH.into_iter().zip(anchors) {
                let found = pencils.position(anchor).expect("near the image");
                assert!(found.distance(&Pixel::new(u, v)) < 1e-9, "{layout:?} {found:?}");
            }
            for (anchor, pixels) in Anchor::BOTH.into_iter().zip([pixels_of_first, pixels_of_second]) {
                for (u, v) in pixels {
                    assert_eq!(pencils.anchor_of(Pixel::new(u, v)), anchor, "{layout:?} {u} {v}");
                }
            }
        }
    }

    #[test]
    fn layout_numbers_round_trip_after_rounding() {
        let DclLayout::Halves(layout) = DclLayout::halves(30.004, 2.0).expect("allowed") else {
            panic!("two halves")
        };
        assert_eq!((layout.degrees(), layout.s()), (30.0, 2.0));
        assert_eq!(DclLayout::halves(179.999, 1.0).expect("allowed"), DclLayout::HORIZONTAL);
        assert_eq!(DclLayout::halves(90.0, 1.0).expect("allowed"), DclLayout::VERTICAL);
        for (degrees, s) in
            [(180.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0), (90.0, 0.0), (90.0, 21.0), (90.0, f64::INFINITY)]
        {
            assert!(DclLayout::halves(degrees, s).is_err(), "{degrees} {s}");
        }
    }
}
