//! Reads posed images from Python, from which maps are built.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_map::{GravityDirection, PosedImage, PosedImages};
use veiloc_mapping::importers::poses;
use veiloc_mapping::structure_from_motion::SfmMatching;
use veiloc_mapping::{OnBadImage, OnOtherCoordinateFrame};

use crate::arrays;
use crate::camera::{camera_of, dictionary};
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// Name, camera and pose of each image.
type Listed<'py> = Vec<(String, Bound<'py, PyDict>, CameraPose)>;

/// Reads images with cameras and poses: a COLMAP model, or a file or folder of nerfstudio, Bundler, VisualSFM, OpenSfM,
/// Metashape, RealityCapture, kapture, Polycam, Record3D, 3D Scanner App, TUM, KITTI or EuRoC. The format is recognized.
///
/// Args:
///     path: the file or folder.
///     images: folder of the images: names are relative to it, and it has the sizes of images that a format does not
///         have. Default: the folder of `path`.
///
/// Returns:
///     A list of (name, camera, CameraPose), as `Map.build` takes it, and a dictionary: `format`; `path`, the file that was
///     read; `down`, the direction of gravity that the format defines, or None; `is_metric`, whether it defines that lengths are
///     metres; `remarks`, what was left out or assumed.
///
/// Raises:
///     MapError: no format is recognized, several are, or the file cannot be read.
#[pyfunction]
#[pyo3(signature = (path, images=None))]
pub(crate) fn read_posed<'py>(
    py: Python<'py>,
    path: PathBuf,
    images: Option<PathBuf>,
) -> Result<(Listed<'py>, Bound<'py, PyDict>)> {
    let folder = if path.is_dir() { Some(path.as_path()) } else { path.parent() };
    let images = images.unwrap_or_else(|| folder.unwrap_or(Path::new(".")).to_owned());
    let read = py.detach(|| poses::read_posed(&path, &images))?;
    let of = |image: &PosedImage| -> Result<_> {
        Ok((image.name.clone(), dictionary(py, &image.camera)?, CameraPose(image.cam_from_world)))
    };
    let listed: Result<Listed<'py>> = read.images.images().iter().map(of).collect();
    let facts = PyDict::new(py);
    facts.set_item("format", read.format.to_string())?;
    facts.set_item("path", read.path)?;
    facts.set_item("is_metric", read.is_metric)?;
    facts.set_item("down", read.down.map(|down| down.in_world()))?;
    facts.set_item("remarks", read.images.remarks())?;
    Ok((listed?, facts))
}

/// Posed images, and what their format defines about the world frame.
pub(crate) struct Posed {
    pub(crate) images: PosedImages,
    /// The direction of gravity; `None` if not defined.
    pub(crate) down: Option<GravityDirection>,
    /// Whether lengths are metres; false if not defined.
    pub(crate) is_metric: bool,
}

/// Posed images from a file or folder of any format, or from a list of (name, camera, pose).
pub(crate) fn posed_of(posed: &Bound<'_, PyAny>, images: &Path) -> Result<Posed> {
    if let Ok(path) = posed.extract::<PathBuf>() {
        let read = poses::read_posed(&path, images)?;
        return Ok(Posed { images: read.images, down: read.down, is_metric: read.is_metric });
    }
    let refused = || {
        BindingError::input(
            "posed: must be the path of posed images, or a list of (name, camera, CameraPose)",
        )
    };
    let image = |entry: PyResult<Bound<'_, PyAny>>| -> Result<PosedImage> {
        let entry = entry?.extract::<(String, Bound<'_, PyAny>, CameraPose)>();
        let (name, camera, pose) = entry.map_err(|_| refused())?;
        Ok(PosedImage { name, camera: camera_of(&camera)?, cam_from_world: pose.0, seen: Vec::new() })
    };
    let images: Result<Vec<PosedImage>> = posed.try_iter().map_err(|_| refused())?.map(image).collect();
    Ok(Posed { images: PosedImages::new(images?, Vec::new())?, down: None, is_metric: false })
}

pub(crate) fn down_of(down: &Bound<'_, PyAny>) -> Result<GravityDirection> {
    match down.extract::<String>() {
        Ok(text) => text.parse::<GravityDirection>().map_err(BindingError::input),
        Err(_) => GravityDirection::new(arrays::vector::<3>("down", down)?).map_err(BindingError::input),
    }
}

/// The treatment of images in another coordinate frame.
pub(crate) fn on_other_coordinate_frame(name: &str) -> Result<OnOtherCoordinateFrame> {
    match name {
        "refuse" => Ok(OnOtherCoordinateFrame::Refuse),
        "align" => Ok(OnOtherCoordinateFrame::Align),
        "accept" => Ok(OnOtherCoordinateFrame::Accept),
        other => Err(BindingError::input(format!(
            "other_coordinate_frame: {other:?} is none of \"refuse\", \"align\", \"accept\""
        ))),
    }
}

/// The image pairs that structure from motion matches.
pub(crate) fn matching_of(name: &str) -> Result<SfmMatching> {
    match name {
        "auto" => Ok(SfmMatching::Auto),
        "exhaustive" => Ok(SfmMatching::Exhaustive),
        "sequential" => Ok(SfmMatching::Sequential),
        other => Err(BindingError::input(format!(
            "matching: {other:?} is none of \"auto\", \"exhaustive\", \"sequential\""
        ))),
    }
}

pub(crate) const fn on_bad(skip_bad: bool) -> OnBadImage {
    if skip_bad { OnBadImage::Skip } else { OnBadImage::Refuse }
}
