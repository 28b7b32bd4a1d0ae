//! EXIF of image files.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use exif::{Exif, Reader};

/// The EXIF of a file, without the fields that are damaged; `None` if it has none, or cannot be read.
pub(crate) fn exif_of(path: &Path) -> Option<Exif> {
    let read = Reader::new()
        .continue_on_error(true)
        .read_from_container(&mut BufReader::new(File::open(path).ok()?));
    read.or_else(|error| error.distill_partial_result(|_| {})).ok()
}
