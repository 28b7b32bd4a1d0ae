//! Recognizes the format of posed images: by the content of a file, by the files of a folder.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::posed_input::PoseFormat::{
    self, Bundler, Euroc, Kapture, Kitti, Metashape, Nerfstudio, Nvm, OpenSfm, Polycam,
};
use super::posed_input::PoseFormat::{Colmap, RealityCapture, Record3d, ScannerApp, Tum};
use super::{ar_capture, bundler, colmap, reality_capture};
use crate::error::MappingError;
use crate::importers::ros_bag::is_bag;

/// Bytes at the start of a file that are looked at.
const HEAD: u64 = 4096;

/// Files of a COLMAP model, which may have rows of numbers.
const OF_COLMAP: [&str; 5] = ["cameras", "images", "points3D", "rigs", "frames"];

/// The format, and the file or folder to read.
pub(super) fn recognize(path: &Path) -> Result<(PoseFormat, PathBuf), MappingError> {
    let kind = path.metadata().map_err(MappingError::io(path))?;
    if is_bag(path) {
        let (what, remedy) = (
            "a bag of ROS",
            "write its images and poses with `python -m veiloc.ros frames BAG --out FOLDER` (pip install 'veiloc[ros]') and give \
             FOLDER/posed and FOLDER/images, or give the bag to `veiloc map build --posed`",
        );
        return Err(MappingError::UnreadPoses { path: path.to_owned(), what, remedy });
    }
    if kind.is_file() {
        let found = of_file(path)?.or_else(|| of_colmap_file(path));
        return match (found, unread(path)) {
            (Some(found), _) => Ok(found),
            (None, Some(unread)) => Err(unread),
            (None, None) => Err(MappingError::UnknownPoses { path: path.to_owned(), is_folder: false }),
        };
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
    let mut broken = None;
    for file in &files {
        let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        let is_of_colmap = extension.as_deref() == Some("txt")
            && file.file_stem().is_some_and(|stem| OF_COLMAP.iter().any(|part| stem == *part));
        let is_metadata = file.file_name().is_some_and(|name| name == "metadata");
        if is_of_colmap || !is_metadata && !extension.is_some_and(|e| extensions.contains(&e.as_str())) {
            continue;
        }
        match of_file(file) {
            // One folder of many such files.
            Ok(Some((ScannerApp | Polycam, folder))) if found.iter().any(|(_, path)| *path == folder) => {}
            Ok(Some(recognized)) => found.push(recognized),
            Ok(None) => {}
            // Another file may be the one.
            Err(error) => broken = broken.or(Some(error)),
        }
    }
    if found.is_empty()
        && let Some(error) = broken.or_else(|| files.iter().find_map(|file| unread(file)))
    {
        return Err(error);
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

/// The start of a file as text.
fn head_of(path: &Path) -> std::io::Result<String> {
    let mut head = Vec::new();
    std::fs::File::open(path)?.take(HEAD).read_to_end(&mut head)?;
    // A character may be cut.
    Ok(veiloc_map::text::text_of(head).unwrap_or_else(|error| {
        String::from_utf8_lossy(veiloc_map::text::without_mark(error.as_bytes())).into_owned()
    }))
}

/// The format of a file by its content.
///
/// # Errors
/// The file cannot be read, or it is JSON with a fault.
fn of_file(path: &Path) -> Result<Option<(PoseFormat, PathBuf)>, MappingError> {
    let head = head_of(path).map_err(MappingError::io(path))?;
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
        return of_json(path);
    }
    let first = start.lines().next().unwrap_or_default();
    if reality_capture::columns(first).is_some() {
        return Ok(here(RealityCapture));
    }
    let is_comment = |line: &&str| line.trim_start().starts_with('#') || line.trim().is_empty();
    // The first row may be a head.
    let rows = start.lines().filter(|line| !is_comment(line)).take(2);
    let counts = rows.filter_map(|row| {
        let words: Vec<&str> = row.split_whitespace().collect();
        words.iter().all(|word| word.parse::<f64>().is_ok()).then_some(words.len())
    });
    Ok(match counts.take(1).next() {
        Some(8) => here(Tum),
        Some(12) => here(Kitti),
        // A Bundler file whose comment was removed.
        Some(2) if bundler::list_of(path).is_some() => here(Bundler),
        _ => None,
    })
}

/// A JSON document by its fields.
fn of_json(path: &Path) -> Result<Option<(PoseFormat, PathBuf)>, MappingError> {
    let value = super::json::document(path)?;
    let has = |key: &str| value.get(key).is_some();
    let folder = || path.parent().unwrap_or(Path::new(".")).to_owned();
    Ok(if has("frames") {
        Some((Nerfstudio, path.to_owned()))
    } else if value.get(0).is_some_and(|first| first.get("shots").is_some()) {
        Some((OpenSfm, path.to_owned()))
    } else if has("poses") && has("K") {
        Some((Record3d, path.to_owned()))
    } else if has("cameraPoseARFrame") {
        Some((ScannerApp, folder()))
    } else {
        (has("t_00") && has("t_23")).then(|| (Polycam, folder()))
    })
}

/// Marks (without spaces) at the start of files with poses that are not read: what the file is, and what to do.
const UNREAD: [(&str, &str, &str); 5] = [
    (
        "SQLiteformat3",
        "COLMAP's database",
        "it has no poses: give the folder of the model that COLMAP's mapper wrote (sparse/0)",
    ),
    (
        "\"sfm_data_version\"",
        "a model of OpenMVG",
        "convert it with openMVG_main_openMVG2Colmap and give the COLMAP model",
    ),
    (
        "\"featuresFolders\"",
        "a model of Meshroom",
        "convert it with aliceVision_exportColmap and give the COLMAP model",
    ),
    (
        "timestamp,frame,x,y,z,qx,qy,qz,qw",
        "the odometry of Stray Scanner",
        "write it as a trajectory of TUM (time x y z qx qy qz qw), with the camera of camera_matrix.csv in cameras.txt",
    ),
    (
        "\"img_name\"",
        "the list of cameras of a gaussian splatting model",
        "give the COLMAP model or the transforms.json that it was trained on",
    ),
];

/// The error for a file with poses of a program that is known and not read.
fn unread(path: &Path) -> Option<MappingError> {
    let head = head_of(path).ok()?.replace(' ', "");
    let is_meshroom = path.extension().is_some_and(|extension| extension == "sfm");
    let (_, what, remedy) = UNREAD
        .into_iter()
        .find(|(mark, what, _)| head.contains(mark) || is_meshroom && what.ends_with("Meshroom"))?;
    Some(MappingError::UnreadPoses { path: path.to_owned(), what, remedy })
}

/// The folder of a model by one of its files.
fn of_colmap_file(path: &Path) -> Option<(PoseFormat, PathBuf)> {
    let name = path.file_name()?.to_string_lossy().into_owned();
    let is_model_file = OF_COLMAP.iter().any(|stem| name.starts_with(stem));
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let model = colmap::model_in(folder).filter(|_| is_model_file)?;
    Some((Colmap, model))
}
