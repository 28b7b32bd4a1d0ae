//! The EXIF orientation of a file. It is read for messages only; it is never applied and never sent.

use std::fmt;
use std::path::Path;

use image::metadata::Orientation;
use veiloc_geometry::QuarterTurns;

use crate::load::header;

/// What a viewer does to an image before it displays it, by the EXIF orientation of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisplayTurn {
    /// Clockwise rotation, degrees: 0, 90, 180 or 270.
    pub degrees: u16,
    /// Whether the image is mirrored.
    pub mirrored: bool,
}

impl DisplayTurn {
    /// Of an EXIF orientation, 1 to 8; `None` if the image is displayed as it is stored, and for other numbers.
    pub(crate) fn of_exif(orientation: u8) -> Option<Self> {
        Self::of(Orientation::from_exif(orientation)?)
    }

    fn of(orientation: Orientation) -> Option<Self> {
        let (degrees, mirrored) = match orientation {
            Orientation::NoTransforms => return None,
            Orientation::Rotate90 => (90, false),
            Orientation::Rotate180 => (180, false),
            Orientation::Rotate270 => (270, false),
            Orientation::FlipHorizontal => (0, true),
            Orientation::FlipVertical => (180, true),
            Orientation::Rotate90FlipH => (90, true),
            Orientation::Rotate270FlipH => (270, true),
        };
        Some(Self { degrees, mirrored })
    }

    /// The rotation.
    pub(crate) fn turns(self) -> QuarterTurns {
        QuarterTurns::from_degrees(i32::from(self.degrees)).unwrap_or_default()
    }
}

impl fmt::Display for DisplayTurn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.degrees, self.mirrored) {
            (0, _) => f.write_str("mirrored"),
            (degrees, true) => write!(f, "mirrored and rotated by {degrees}\u{b0}"),
            (degrees, false) => write!(f, "rotated by {degrees}\u{b0}"),
        }
    }
}

/// The rotation and mirroring of an image file for display; `None` if it is displayed as it is stored, and for files
/// that cannot be read.
pub fn display_turn(path: &Path) -> Option<DisplayTurn> {
    DisplayTurn::of(Orientation::from_exif_chunk(&header(path).ok()?.metadata?)?)
}

/// The clockwise rotation by 90° or 270° of the EXIF orientation, degrees; `None` for all others, and for files without
/// one.
pub(crate) fn turn_of(path: &Path) -> Option<u16> {
    display_turn(path).map(|turn| turn.degrees).filter(|degrees| matches!(degrees, 90 | 270))
}
