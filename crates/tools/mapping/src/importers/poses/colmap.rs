//! A COLMAP model, in the folder or in one that COLMAP and its users make for it: `sparse/0`, `sparse`.

use std::path::{Path, PathBuf};

use veiloc_map::colmap;

use super::posed_input::{PoseFormat, PosedInput};
use crate::error::MappingError;

pub(super) fn read(path: &Path) -> Result<PosedInput, MappingError> {
    let images = colmap::read_posed(path)?;
    let remarks = others(path).map(|others| {
        let listed: Vec<String> = others.iter().map(|other| other.display().to_string()).collect();
        format!("further models beside it are not read, because their frames differ: {}", listed.join(", "))
    });
    let remarks = images.remarks().iter().cloned().chain(remarks).collect();
    let images = images.with_remarks(remarks);
    Ok(PosedInput { images, format: PoseFormat::Colmap, path: path.to_owned(), down: None, is_metric: false })
}

/// The folder of the model that `folder` is or holds: of several numbered ones that with the most images.
pub(super) fn model_in(folder: &Path) -> Option<PathBuf> {
    if is_model(folder) {
        return Some(folder.to_owned());
    }
    let sparse = ["sparse", "colmap/sparse", "."].map(|inside| folder.join(inside));
    sparse.iter().find_map(|sparse| {
        if is_model(sparse) {
            return Some(sparse.clone());
        }
        let size = |model: &PathBuf| {
            let file = ["images.bin", "images.txt"].map(|file| model.join(file).metadata());
            file.into_iter().flatten().map(|file| file.len()).next()
        };
        // Of equally large ones the first.
        numbered(sparse).into_iter().rev().max_by_key(size)
    })
}

/// The other models in the folder of a numbered one.
fn others(model: &Path) -> Option<Vec<PathBuf>> {
    is_number(model).then_some(())?;
    let others: Vec<PathBuf> = numbered(model.parent()?).into_iter().filter(|other| other != model).collect();
    (!others.is_empty()).then_some(others)
}

/// Models in folders called by a number, ascending.
pub(crate) fn numbered(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut models: Vec<PathBuf> = entries.filter(|path| is_number(path) && is_model(path)).collect();
    models.sort();
    models
}

fn is_number(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().parse::<u32>().is_ok())
}

fn is_model(folder: &Path) -> bool {
    ["bin", "txt"].into_iter().any(|ending| {
        ["cameras", "images"].into_iter().all(|file| folder.join(file).with_extension(ending).is_file())
    })
}
