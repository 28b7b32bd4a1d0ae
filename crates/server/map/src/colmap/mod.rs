//! COLMAP models: cameras, posed images with their 2D points, 3D points with their tracks.
//!
//! The three files `cameras`, `images`, `points3D` are read as text (`.txt`) or binary (`.bin`); where a folder has
//! both, the binary ones are read, as COLMAP does. Where `rigs` and `frames` are beside them, as COLMAP 3.12 and newer
//! write them, they hold the poses: an `images` file that says otherwise is overruled, with a remark. Both are written
//! too.
//!
//! An accepted model is consistent (see [`ColmapModel::new`]), so later steps need no index checks. Images whose pose is
//! none, or whose camera has no model here, are left out with a remark ([`ColmapModel::remarks`]), and so are points and
//! observations that `images` and `points3D` do not agree on. Lengths in a file are checked before memory is allocated.

mod binary;
mod export;
mod folder;
mod model;
mod parts;
mod posed;
mod reconcile;
mod records;
mod rigs;
mod text;
mod write;
mod write_binary;

use std::path::Path;

pub use export::export;
pub use model::ColmapModel;
pub use records::{ColmapImage, ColmapPoint, ColmapPoint2d};
pub use rigs::{ColmapFrame, ColmapRig, ColmapRigs, ColmapSensor, SensorKind};
pub use write::{check_text_folder, write_text};
pub use write_binary::write_binary;

use crate::error::MapError;
use crate::posed::PosedImages;

/// Reads the model in a folder, text or binary.
///
/// # Errors
/// [`MapError`] with file, position and remedy: no model, a record that cannot be parsed, an unsupported camera
/// model, numbers of cameras and poses that are not finite, duplicate ids or names of cameras and images.
pub fn read_model(dir: &Path) -> Result<ColmapModel, MapError> {
    match ModelFiles::in_folder(dir) {
        Some(files) if files.points => {
            let points = files.read_points(dir)?;
            files.read(dir, points, Vec::new())
        }
        _ => Err(no_model(dir, "cameras, images and points3D")),
    }
}

/// Reads cameras and poses of the model in a folder, text or binary, and its points if present.
///
/// # Errors
/// As for [`read_model`], but a folder without `points3D` is a model without points, and so is one whose `points3D`
/// cannot be read, with a remark ([`PosedImages::remarks`]).
pub fn read_posed(dir: &Path) -> Result<PosedImages, MapError> {
    let files = ModelFiles::in_folder(dir).ok_or_else(|| no_model(dir, "cameras and images"))?;
    let points = if files.points { files.read_points(dir) } else { Ok(Vec::new()) };
    let (points, remarks) = match points {
        Ok(points) => (points, Vec::new()),
        Err(error) => (Vec::new(), vec![format!("the points of the model are not used: {error}")]),
    };
    let files = ModelFiles { points: files.points && remarks.is_empty(), ..files };
    Ok(PosedImages::from(&files.read(dir, points, remarks)?))
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
            let needed: &[&str] =
                if files.points { &["cameras", "images", "points3D"] } else { &["cameras", "images"] };
            needed.iter().all(|file| files.has(dir, file))
        };
        let order = [(true, true), (false, true), (true, false), (false, false)];
        order.into_iter().map(|(binary, points)| Self { binary, points }).find(has)
    }

    fn has(self, dir: &Path, file: &str) -> bool {
        dir.join(file).with_extension(if self.binary { "bin" } else { "txt" }).is_file()
    }

    fn read_points(self, dir: &Path) -> Result<Vec<ColmapPoint>, MapError> {
        if self.binary { binary::read_points(dir) } else { text::read_points(dir) }
    }

    fn read(
        self,
        dir: &Path,
        points: Vec<ColmapPoint>,
        remarks: Vec<String>,
    ) -> Result<ColmapModel, MapError> {
        let mut parts = if self.binary { binary::read(dir)? } else { text::read(dir)? };
        (parts.points, parts.remarks) = (points, remarks);
        parts.leave_out_odd()?;
        if self.has(dir, "rigs") && self.has(dir, "frames") {
            let rigs = if self.binary { binary::read_rigs(dir)? } else { text::read_rigs(dir)? };
            parts.pose_by(rigs).map_err(|reason| MapError::ColmapRigs { dir: dir.to_owned(), reason })?;
        }
        if self.points {
            parts.reconcile();
        } else {
            parts.forget_points();
        }
        ColmapModel::checked(parts, Some(dir))
    }
}

#[cfg(test)]
mod tests;
