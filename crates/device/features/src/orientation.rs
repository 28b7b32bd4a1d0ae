//! The EXIF orientation of a file. It is read for a message only; it is never applied and never sent.

use std::path::Path;

use image::metadata::Orientation;
use image::{ImageDecoder, ImageReader};

/// The clockwise rotation by 90° or 270° of the EXIF orientation, degrees; `None` for all others, and for files without
/// one.
pub(crate) fn turn_of(path: &Path) -> Option<u16> {
    let mut decoder = ImageReader::open(path).ok()?.with_guessed_format().ok()?.into_decoder().ok()?;
    match decoder.orientation().ok()? {
        Orientation::Rotate90 | Orientation::Rotate90FlipH => Some(90),
        Orientation::Rotate270 | Orientation::Rotate270FlipH => Some(270),
        Orientation::NoTransforms
        | Orientation::Rotate180
        | Orientation::FlipHorizontal
        | Orientation::FlipVertical => None,
    }
}
