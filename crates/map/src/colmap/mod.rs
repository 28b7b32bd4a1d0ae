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
mod model;
mod text;
mod write;

use std::path::Path;

pub use export::export;
pub use model::{ColmapImage, ColmapModel, ColmapPoint, ColmapPoint2d};
pub use write::write_text;

use crate::error::MapError;

/// The parts of a model as a file format delivers them, before they were held against each other.
#[derive(Default)]
pub(crate) struct Parts {
    pub(crate) cameras: Vec<(u32, veiloc_geometry::Intrinsics)>,
    pub(crate) images: Vec<ColmapImage>,
    pub(crate) points: Vec<ColmapPoint>,
}

/// Reads the model in a folder, text or binary.
///
/// # Errors
/// [`MapError`] naming the file, the place in it and the remedy: no model, a record that does not parse, an unsupported
/// camera model, numbers that are not finite, duplicate ids or names, references to what is not there.
pub fn read_model(dir: &Path) -> Result<ColmapModel, MapError> {
    let has = |extension: &str| {
        ["cameras", "images", "points3D"].iter().all(|f| dir.join(format!("{f}.{extension}")).is_file())
    };
    let parts = if has("bin") {
        binary::read(dir)?
    } else if has("txt") {
        text::read(dir)?
    } else {
        return Err(MapError::NoColmapModel { dir: dir.to_owned() });
    };
    ColmapModel::checked(parts, Some(dir))
}

#[cfg(test)]
mod tests;
