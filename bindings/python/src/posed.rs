//! Reads posed images from Python, from which maps are built.

use std::path::PathBuf;

use pyo3::prelude::*;
use veiloc_map::colmap::read_posed;
use veiloc_map::{GravityDirection, PosedImage, PosedImages};
use veiloc_mapping::{OnBadImage, OnOtherFrame};

use crate::arrays;
use crate::camera::camera_of;
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// Posed images from the folder of a COLMAP model, or from a list of (name, camera, pose).
pub(crate) fn posed_of(posed: &Bound<'_, PyAny>) -> Result<PosedImages> {
    if let Ok(folder) = posed.extract::<PathBuf>() {
        return Ok(read_posed(&folder)?);
    }
    let refused = || {
        BindingError::input(
            "posed: must be the folder of a COLMAP model, or a list of (name, camera, CameraPose)",
        )
    };
    let image = |entry: PyResult<Bound<'_, PyAny>>| -> Result<PosedImage> {
        let entry = entry?.extract::<(String, Bound<'_, PyAny>, CameraPose)>();
        let (name, camera, pose) = entry.map_err(|_| refused())?;
        Ok(PosedImage { name, camera: camera_of(&camera)?, cam_from_world: pose.0, seen: Vec::new() })
    };
    let images: Result<Vec<PosedImage>> = posed.try_iter().map_err(|_| refused())?.map(image).collect();
    Ok(PosedImages::new(images?, Vec::new())?)
}

pub(crate) fn down_of(down: &Bound<'_, PyAny>) -> Result<GravityDirection> {
    match down.extract::<String>() {
        Ok(text) => text.parse::<GravityDirection>().map_err(BindingError::input),
        Err(_) => GravityDirection::new(arrays::vector::<3>("down", down)?).map_err(BindingError::input),
    }
}

/// The treatment of images in another frame.
pub(crate) fn on_other_frame(name: &str) -> Result<OnOtherFrame> {
    match name {
        "refuse" => Ok(OnOtherFrame::Refuse),
        "align" => Ok(OnOtherFrame::Align),
        "accept" => Ok(OnOtherFrame::Accept),
        other => Err(BindingError::input(format!(
            "other_frame: {other:?} is none of \"refuse\", \"align\", \"accept\""
        ))),
    }
}

pub(crate) const fn on_bad(skip_bad: bool) -> OnBadImage {
    if skip_bad { OnBadImage::Skip } else { OnBadImage::Refuse }
}
