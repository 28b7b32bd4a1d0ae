//! Reads posed images of any format, and says which it was and what was left out of them.

use std::path::Path;

use veiloc_map::PosedImages;
use veiloc_mapping::importers::poses::{self, PosedInput};

use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// Reads posed images; `images` is the folder of the images.
///
/// # Errors
/// No format is recognized, several are, or the file cannot be read.
pub(crate) fn read_posed(path: &Path, images: &Path, ui: &Ui) -> Result<PosedImages, Failure> {
    Ok(read_posed_input(path, images, ui)?.images)
}

/// The same with what the format says about the world frame.
pub(crate) fn read_posed_input(path: &Path, images: &Path, ui: &Ui) -> Result<PosedInput, Failure> {
    let read = poses::read_posed(path, images)?;
    // The folder of a COLMAP model needs no word.
    if read.path != path || read.format != poses::PoseFormat::Colmap {
        ui.info(format_args!(
            "{}: {}, {} images",
            read.path.display(),
            read.format,
            read.images.images().len()
        ));
    }
    warn_of(&read.path, read.images.remarks(), ui);
    Ok(read)
}

/// Warns of what reading posed images left out or changed.
pub(crate) fn warn_of(path: &Path, remarks: &[String], ui: &Ui) {
    for remark in remarks {
        ui.warn(format_args!("warning: {}: {remark}", path.display()));
    }
}
