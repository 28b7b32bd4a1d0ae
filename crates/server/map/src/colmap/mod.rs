//! COLMAP models: cameras, posed images with their 2D points, 3D points with their tracks.
//!
//! The three files `cameras`, `images`, `points3D` are read as text (`.txt`) or binary (`.bin`); where a folder has
//! both, the binary ones are read, as COLMAP does. `frames` and `rigs`, which newer COLMAPs write beside them, hold
//! nothing that these three do not say for single cameras, and are ignored.
//!
//! Reading is strict: what is accepted holds together (see [`ColmapModel::new`]), so that no later step needs to
//! doubt an index. Lengths claimed by a file are never trusted with memory.

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
/// [`MapError`] naming the file, the place in it and the remedy: no model, a record that does not parse, an unsupported
/// camera model, numbers that are not finite, duplicate ids or names, references to what is not there.
pub fn read_model(dir: &Path) -> Result<ColmapModel, MapError> {
    match Found::in_folder(dir) {
        Some(found) if found.points => found.read(dir),
        _ => Err(MapError::NoColmapModel { dir: dir.to_owned(), wanted: "cameras, images and points3D" }),
    }
}

/// Reads cameras and poses of the model in a folder, text or binary, and the points where they are there.
///
/// # Errors
/// As for [`read_model`]; but a folder without `points3D` is a model whose images see nothing yet.
pub fn read_posed(dir: &Path) -> Result<PosedImages, MapError> {
    let found = Found::in_folder(dir)
        .ok_or_else(|| MapError::NoColmapModel { dir: dir.to_owned(), wanted: "cameras and images" })?;
    Ok(PosedImages::from(&found.read(dir)?))
}

/// Which files of a model a folder holds.
#[derive(Clone, Copy)]
struct Found {
    binary: bool,
    points: bool,
}

impl Found {
    /// A model with points before one without, binary before text.
    fn in_folder(dir: &Path) -> Option<Self> {
        let has = |found: &Self| {
            let extension = if found.binary { "bin" } else { "txt" };
            let files: &[&str] =
                if found.points { &["cameras", "images", "points3D"] } else { &["cameras", "images"] };
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
