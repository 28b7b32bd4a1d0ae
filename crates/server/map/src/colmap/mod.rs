//! COLMAP models: cameras, posed images with their 2D points, 3D points with their tracks.
//!
//! The three files `cameras`, `images`, `points3D` are read as text (`.txt`) or binary (`.bin`); where a folder has
//! both, the binary ones are read, as COLMAP does. `frames` and `rigs`, which newer COLMAPs write beside them, hold
//! nothing that these three do not say for single cameras, and are ignored.
//!
//! Reading is strict: an accepted model is consistent (see [`ColmapModel::new`]), so later steps need no index
//! checks. Lengths in a file are checked before memory is allocated.

mod binary;
mod export;
mod folder;
mod model;
mod posed;
mod text;
mod write;
mod write_binary;

use std::path::Path;

pub use export::export;
pub use model::{ColmapImage, ColmapModel, ColmapPoint, ColmapPoint2d};
pub use write::write_text;
pub use write_binary::write_binary;

use crate::error::MapError;
use crate::posed::PosedImages;

/// Reads the model in a folder, text or binary.
///
/// # Errors
/// [`MapError`] with file, position and remedy: no model, a record that cannot be parsed, an unsupported camera
/// model, non-finite numbers, duplicate ids or names, dangling references.
pub fn read_model(dir: &Path) -> Result<ColmapModel, MapError> {
    match ModelFiles::in_folder(dir) {
        Some(files) if files.points => files.read(dir),
        _ => Err(no_model(dir, "cameras, images and points3D")),
    }
}

/// Reads cameras and poses of the model in a folder, text or binary, and its points if present.
///
/// # Errors
/// As for [`read_model`], but a folder without `points3D` is a model without points.
pub fn read_posed(dir: &Path) -> Result<PosedImages, MapError> {
    let files = ModelFiles::in_folder(dir).ok_or_else(|| no_model(dir, "cameras and images"))?;
    Ok(PosedImages::from(&files.read(dir)?))
}

/// The error for a folder without a model, which names the folders in it that hold one: COLMAP writes its models into
/// `sparse/0`, `sparse/1`, ….
fn no_model(dir: &Path, wanted: &'static str) -> MapError {
    let folders = std::fs::read_dir(dir).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut inside: Vec<_> = folders.filter(|folder| ModelFiles::in_folder(folder).is_some()).collect();
    inside.sort();
    MapError::NoColmapModel { dir: dir.to_owned(), inside, wanted }
}

/// The files of a model in a folder.
#[derive(Clone, Copy)]
struct ModelFiles {
    binary: bool,
    points: bool,
}

impl ModelFiles {
    /// Prefers models with points, then binary ones.
    fn in_folder(dir: &Path) -> Option<Self> {
        let has = |files: &Self| {
            let extension = if files.binary { "bin" } else { "txt" };
            let files: &[&str] =
                if files.points { &["cameras", "images", "points3D"] } else { &["cameras", "images"] };
            files.iter().all(|f| dir.join(format!("{f}.{extension}")).is_file())
        };
        let order = [(true, true), (false, true), (true, false), (false, false)];
        order.into_iter().map(|(binary, points)| Self { binary, points }).find(has)
    }

    fn read(self, dir: &Path) -> Result<ColmapModel, MapError> {
        let read = if self.binary { binary::read } else { text::read };
        let mut parts = read(dir, self.points)?;
        if !self.points {
            parts.forget_points();
        }
        ColmapModel::checked(parts, Some(dir))
    }
}

#[cfg(test)]
mod tests;
