//! Reads cameras: PoseLib's and COLMAP's dictionaries, pycolmap's objects, or one line of text with commas or spaces.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_geometry::{Intrinsics, Pixel};

use crate::arrays;
use crate::errors::{BindingError, Result};

const KEYS: [&str; 4] = ["model", "width", "height", "params"];

/// A camera from `{"model", "width", "height", "params"}`, from `MODEL,WIDTH,HEIGHT,PARAMS…` (commas or spaces), or from
/// an object with these attributes, such as pycolmap's `Camera`.
pub(crate) fn camera_of(camera: &Bound<'_, PyAny>) -> Result<Intrinsics> {
    if let Ok(text) = camera.extract::<String>() {
        return Ok(text.parse::<Intrinsics>()?);
    }
    let field = |key: &str| -> Result<Bound<'_, PyAny>> {
        let value = match camera.cast::<PyDict>() {
            Ok(fields) => fields.get_item(key)?,
            Err(_) => camera.getattr(key).ok(),
        };
        value.ok_or_else(|| {
            BindingError::input(format_args!(
                "camera: no {key:?}; give {{\"model\", \"width\", \"height\", \"params\"}} or \"MODEL,WIDTH,HEIGHT,PARAMS…\""
            ))
        })
    };
    if let Ok(fields) = camera.cast::<PyDict>() {
        let unknown =
            fields.keys().iter().map(|key| key.to_string()).find(|key| !KEYS.contains(&key.as_str()));
        if let Some(unknown) = unknown {
            return Err(BindingError::input(format_args!(
                "camera: unknown key {unknown:?}; the keys are {}",
                KEYS.join(", ")
            )));
        }
    }
    let model = field("model")?;
    // In pycolmap the model is a member of an enumeration, with an attribute `name`.
    let model = model.extract::<String>().or_else(|_| model.getattr("name")?.extract::<String>())?;
    let size = |key: &str| -> Result<u32> {
        field(key)?
            .extract::<u32>()
            .map_err(|_| BindingError::input(format_args!("camera: {key} must be a number of pixels")))
    };
    let params = arrays::numbers::<f64>("camera: params", &field("params")?)?;
    Ok(Intrinsics::new(&model, size("width")?, size("height")?, &params)?)
}

/// A camera as a dictionary with these keys.
pub(crate) fn dictionary<'py>(py: Python<'py>, camera: &Intrinsics) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("model", camera.model.name())?;
    dict.set_item("width", camera.width)?;
    dict.set_item("height", camera.height)?;
    dict.set_item("params", camera.model.params().to_vec())?;
    Ok(dict)
}

/// Undistorts pixels: their positions in the image of the same camera without distortion.
pub(crate) fn undistorted(camera: &Intrinsics, pixels: Vec<Pixel>) -> Result<Vec<Pixel>> {
    let one = |(index, pixel): (usize, Pixel)| {
        let refused = || {
            if !(pixel.u.is_finite() && pixel.v.is_finite()) {
                return BindingError::input(format_args!("points2d: point {index} is not finite"));
            }
            BindingError::input(format_args!(
                "points2d: point {index} cannot be undistorted: no ray in front of the camera belongs to it"
            ))
        };
        camera.undistort_pixel(pixel).ok_or_else(refused)
    };
    pixels.into_iter().enumerate().map(one).collect()
}
