//! The EXIF orientation of a file. It is read for messages only; it is never applied and never sent.

use std::fmt;
use std::path::Path;

use image::metadata::Orientation;

use crate::load::header;

/// What a viewer does to an image before it displays it, by the EXIF orientation of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisplayTurn {
    /// Clockwise rotation, degrees: 0, 90, 180 or 270.
    pub degrees: u16,
    /// Whether the image is mirrored.
    pub mirrored: bool,
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
    let (degrees, mirrored) = match Orientation::from_exif_chunk(&header(path).ok()?.metadata?)? {
        Orientation::NoTransforms => return None,
        Orientation::Rotate90 => (90, false),
        Orientation::Rotate180 => (180, false),
        Orientation::Rotate270 => (270, false),
        Orientation::FlipHorizontal => (0, true),
        Orientation::FlipVertical => (180, true),
        Orientation::Rotate90FlipH => (90, true),
        Orientation::Rotate270FlipH => (270, true),
    };
    Some(DisplayTurn { degrees, mirrored })
}

/// The clockwise rotation by 90° or 270° of the EXIF orientation, degrees; `None` for all others, and for files without
/// one.
pub(crate) fn turn_of(path: &Path) -> Option<u16> {
    display_turn(path).map(|turn| turn.degrees).filter(|degrees| matches!(degrees, 90 | 270))
}
