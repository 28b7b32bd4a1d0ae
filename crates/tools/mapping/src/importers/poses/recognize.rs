//! Recognizes the format of posed images: by the content of a file, by the files of a folder.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::posed_input::PoseFormat::{
    self, Bundler, Euroc, Kapture, Kitti, Metashape, Nerfstudio, Nvm, OpenSfm, Polycam,
};
use super::posed_input::PoseFormat::{Colmap, RealityCapture, Record3d, ScannerApp, Tum};
use super::{ar_capture, bundler, colmap, reality_capture};
use crate::error::MappingError;

/// Bytes at the start of a file that are looked at.
const HEAD: u64 = 4096;

/// Files of a COLMAP model, which may have rows of numbers.
const OF_COLMAP: [&str; 5] = ["cameras", "images", "points3D", "rigs", "frames"];

/// The format, and the file or folder to read.
pub(super) fn recognize(path: &Path) -> Result<(PoseFormat, PathBuf), MappingError> {
    let kind = path.metadata().map_err(MappingError::io(path))?;
    if kind.is_file() {
        let found = of_file(path)?.or_else(|| of_colmap_file(path));
        return found.ok_or_else(|| MappingError::UnknownPoses { path: path.to_owned(), is_folder: false });
    }
    let mut found = in_folder(path)?;
    match found.len() {
        0 => Err(MappingError::UnknownPoses { path: path.to_owned(), is_folder: true }),
        1 => Ok(found.remove(0)),
        _ => {
            let found = found.into_iter().map(|(format, path)| (format.to_string(), path)).collect();
            Err(MappingError::AmbiguousPoses { path: path.to_owned(), found })
        }
    }
}

fn in_folder(folder: &Path) -> Result<Vec<(PoseFormat, PathBuf)>, MappingError> {
    let mut found = Vec::new();
    if let Some(model) = colmap::model_in(folder) {
        found.push((Colmap, model));
    }
    if folder.join("sensors/sensors.txt").is_file() {
        found.push((Kapture, folder.to_owned()));
    }
    for sequence in [folder.join("mav0"), folder.to_owned()] {
        if sequence.join("cam0/sensor.yaml").is_file() {
            found.push((Euroc, sequence));
        }
    }
    let of_polycam = ["keyframes/corrected_cameras", "keyframes/cameras", "corrected_cameras", "cameras"];
    let polycam = of_polycam.map(|inside| folder.join(inside));
    if let Some(cameras) = polycam.into_iter().find(|cameras| !ar_capture::json_files(cameras).is_empty()) {
        found.push((Polycam, cameras));
    }
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(MappingError::io(folder))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    let extensions = ["json", "out", "nvm", "xml", "csv", "txt", "tum", "kitti"];
    for file in files {
        let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        let is_of_colmap = extension.as_deref() == Some("txt")
            && file.file_stem().is_some_and(|stem| OF_COLMAP.iter().any(|part| stem == *part));
        let is_metadata = file.file_name().is_some_and(|name| name == "metadata");
        if is_of_colmap || !is_metadata && !extension.is_some_and(|e| extensions.contains(&e.as_str())) {
            continue;
        }
        match of_file(&file)? {
            // One folder of many such files.
            Some((ScannerApp | Polycam, folder)) if found.iter().any(|(_, path)| *path == folder) => {}
            Some(recognized) => found.push(recognized),
            None => {}
        }
    }
    // Text files of numbers are many; they count if nothing else is there.
    let is_trajectory = |(format, _): &(PoseFormat, PathBuf)| matches!(format, Tum | Kitti);
    if found.iter().any(|entry| !is_trajectory(entry)) {
        found.retain(|entry| !is_trajectory(entry));
    }
    // VisualSFM writes both; the .nvm has the distortion as it was estimated.
    if found.iter().any(|(format, _)| *format == Nvm) {
        found.retain(|(format, _)| *format != Bundler);
    }
    Ok(found)
}

/// The format of a file by its content.
fn of_file(path: &Path) -> Result<Option<(PoseFormat, PathBuf)>, MappingError> {
    let mut head = Vec::new();
    let file = std::fs::File::open(path).map_err(MappingError::io(path))?;
    file.take(HEAD).read_to_end(&mut head).map_err(MappingError::io(path))?;
    let head = String::from_utf8_lossy(veiloc_map::text::without_mark(&head)).into_owned();
    let start = head.trim_start();
    let here = |format| Some((format, path.to_owned()));
    if start.starts_with("NVM_V3") {
        return Ok(here(Nvm));
    }
    if start.starts_with("# Bundle file") {
        return Ok(here(Bundler));
    }
    if start.starts_with('<') {
        return Ok(if head.contains("<chunk") || head.contains("<document") {
            here(Metashape)
        } else {
            None
        });
    }
    if start.starts_with('{') || start.starts_with('[') {
        return Ok(of_json(path));
    }
    let first = start.lines().next().unwrap_or_default();
    let columns: Vec<&str> = first.split(',').map(str::trim).collect();
    if reality_capture::COLUMNS.iter().all(|column| columns.contains(column)) {
        return Ok(here(RealityCapture));
    }
    let row = start.lines().find(|line| !line.trim_start().starts_with('#') && !line.trim().is_empty());
    let numbers: Option<Vec<f64>> =
        row.and_then(|row| row.split_whitespace().map(|word| word.parse().ok()).collect());
    Ok(match numbers.map(|numbers| numbers.len()) {
        Some(8) => here(Tum),
        Some(12) => here(Kitti),
        // A Bundler file whose comment was removed.
        Some(2) if bundler::list_of(path).is_some() => here(Bundler),
        _ => None,
    })
}

/// A JSON document by its fields.
fn of_json(path: &Path) -> Option<(PoseFormat, PathBuf)> {
    let value = super::json::document(path).ok()?;
    let has = |key: &str| value.get(key).is_some();
    let folder = || path.parent().unwrap_or(Path::new(".")).to_owned();
    if has("frames") {
        return Some((Nerfstudio, path.to_owned()));
    }
    if value.get(0).is_some_and(|first| first.get("shots").is_some()) {
        return Some((OpenSfm, path.to_owned()));
    }
    if has("poses") && has("K") {
        return Some((Record3d, path.to_owned()));
    }
    if has("cameraPoseARFrame") {
        return Some((ScannerApp, folder()));
    }
    (has("t_00") && has("fx")).then(|| (Polycam, folder()))
}

/// The folder of a model by one of its files.
fn of_colmap_file(path: &Path) -> Option<(PoseFormat, PathBuf)> {
    let name = path.file_name()?.to_string_lossy().into_owned();
    let is_model_file = OF_COLMAP.iter().any(|stem| name.starts_with(stem));
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let model = colmap::model_in(folder).filter(|_| is_model_file)?;
    Some((Colmap, model))
}
