//! File formats that several layouts share.

use std::fmt::Write as _;
use std::path::Path;

use veiloc_geometry::CameraFromWorld;

use super::view::DatasetCamera;
use crate::error::DatasetError;

/// Creates the folder and writes the file atomically.
pub(crate) fn save_text(path: &Path, text: &str) -> Result<(), DatasetError> {
    make_folder_of(path)?;
    veiloc_map::atomic_file::write_atomic(path, text.as_bytes()).map_err(DatasetError::io(path))
}

/// Creates the folder of a file.
pub(crate) fn make_folder_of(path: &Path) -> Result<(), DatasetError> {
    let Some(folder) = path.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(DatasetError::io(folder))
}

/// Numbers separated by blanks, with enough digits to read them back exactly.
pub(crate) fn numbers(out: &mut String, numbers: impl IntoIterator<Item = f64>) {
    for number in numbers {
        write!(out, " {number}").expect("a string takes all that is written to it");
    }
}

/// Quaternion `w x y z` and translation, world to camera.
pub(crate) fn quaternion_and_translation(pose: &CameraFromWorld) -> impl Iterator<Item = f64> {
    let t = pose.translation();
    pose.quaternion().into_iter().chain([t.x, t.y, t.z])
}

/// A VisualSFM model with cameras only.
pub(crate) fn nvm(cameras: &[(String, CameraFromWorld)], lens: &DatasetCamera) -> String {
    let mut out = format!("NVM_V3\n\n{}\n", cameras.len());
    for (name, pose) in cameras {
        let c = pose.center().coords;
        out.push_str(name);
        numbers(&mut out, [lens.focal]);
        numbers(&mut out, pose.quaternion());
        numbers(&mut out, [c.x, c.y, c.z, lens.distortion, 0.0]);
        out.push('\n');
    }
    out.push_str("\n0\n\n0\n");
    out
}
