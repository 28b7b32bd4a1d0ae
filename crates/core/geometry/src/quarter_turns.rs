//! Rotations of an image by multiples of 90°.

use nalgebra::{Matrix3, Rotation3};

/// A clockwise rotation of an image by a multiple of 90°: how a phone's sensor image is turned to stand upright.
///
/// ```text
/// 0°        90°          180°         270°
/// A B       C A          D C          B D
/// C D       D B          B A          A C
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct QuarterTurns(u8);

impl QuarterTurns {
    /// The image as it is.
    pub const NONE: Self = Self(0);
    /// All of them, by their number.
    pub const ALL: [Self; 4] = [Self(0), Self(1), Self(2), Self(3)];

    /// From degrees clockwise, negative ones counter-clockwise; `None` when they are no multiple of 90.
    pub const fn from_degrees(degrees: i32) -> Option<Self> {
        if degrees % 90 == 0 { Some(Self((degrees.rem_euclid(360) / 90) as u8)) } else { None }
    }

    /// Degrees clockwise: 0, 90, 180 or 270.
    pub const fn degrees(self) -> u16 {
        self.0 as u16 * 90
    }

    /// The number of quarter turns, 0 to 3.
    pub const fn count(self) -> u8 {
        self.0
    }

    /// The turn back.
    #[must_use]
    pub const fn inverse(self) -> Self {
        Self((4 - self.0) % 4)
    }

    /// Width and height of the turned image.
    pub const fn size_of(self, (width, height): (u32, u32)) -> (u32, u32) {
        if self.0.is_multiple_of(2) { (width, height) } else { (height, width) }
    }

    /// The pixel of an image of this width and height that lies at column `x` and row `y` of the turned image.
    pub const fn source_of(self, (width, height): (u32, u32), (x, y): (u32, u32)) -> (u32, u32) {
        match self.0 {
            0 => (x, y),
            1 => (y, height - 1 - x),
            2 => (width - 1 - x, height - 1 - y),
            _ => (width - 1 - y, x),
        }
    }

    /// The rotation from the axes of the camera to those of the camera of the turned image (`x` right, `y` down, `z`
    /// forward in both): a rotation about `z`.
    pub fn turned_from_camera(self) -> Rotation3<f64> {
        let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][self.0 as usize];
        Rotation3::from_matrix_unchecked(Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_round_trip() {
        for (turns, degrees) in QuarterTurns::ALL.into_iter().zip([0, 90, 180, 270]) {
            assert_eq!(QuarterTurns::from_degrees(degrees), Some(turns));
            assert_eq!(QuarterTurns::from_degrees(degrees - 360), Some(turns));
            assert_eq!(i32::from(turns.degrees()), degrees);
            let there_and_back = turns.inverse().turned_from_camera() * turns.turned_from_camera();
            assert!((there_and_back.matrix() - Matrix3::identity()).norm() == 0.0);
        }
        assert_eq!(QuarterTurns::from_degrees(45), None);
        // The drawing above, with an image of two columns and three rows.
        let corners = QuarterTurns::ALL.map(|turns| turns.source_of((2, 3), (0, 0)));
        assert_eq!(corners, [(0, 0), (0, 2), (1, 2), (1, 0)], "A, C, D and B");
    }
}
