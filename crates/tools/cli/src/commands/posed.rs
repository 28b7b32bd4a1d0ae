//! Reads posed images, and says what was left out of them.

use std::path::Path;

use veiloc_map::PosedImages;
use veiloc_map::colmap;

use crate::exit::Failure;
use crate::ui::Ui;

/// Reads the posed images of a COLMAP model, and warns of what is left out.
///
/// # Errors
/// The folder has no model that can be read.
pub(crate) fn read_posed(folder: &Path, ui: &Ui) -> Result<PosedImages, Failure> {
    let posed = colmap::read_posed(folder)?;
    warn_of(folder, posed.remarks(), ui);
    Ok(posed)
}

/// Warns of what reading a COLMAP model left out or changed.
pub(crate) fn warn_of(folder: &Path, remarks: &[String], ui: &Ui) {
    for remark in remarks {
        ui.warn(format_args!("warning: {}: {remark}", folder.display()));
    }
}
