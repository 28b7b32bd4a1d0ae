//! Reads the parts of COLMAP models that hloc's localization needs, without COLMAP.

use std::collections::HashMap;
use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_map::colmap::read_model;

use crate::arrays;
use crate::camera::{camera_of, dictionary, undistorted};
use crate::errors::Result;
use crate::pose::CameraPose;

/// A COLMAP model, text or binary.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct ColmapModel {
    model: veiloc_map::colmap::ColmapModel,
    row_of_point: HashMap<u64, i64>,
}

#[pymethods]
impl ColmapModel {
    /// Reads the model in a folder.
    ///
    /// Raises:
    ///     MapError: the model cannot be read.
    #[staticmethod]
    fn open(py: Python<'_>, folder: PathBuf) -> Result<Self> {
        let model = py.detach(|| read_model(&folder))?;
        let row_of_point = (0..).zip(model.points()).map(|(row, point)| (point.id, row)).collect();
        Ok(Self { model, row_of_point })
    }

    /// Names of the images.
    #[getter]
    fn image_names(&self) -> Vec<String> {
        self.model.image_names()
    }

    /// Pose of an image; None when the model has no image of this name.
    fn pose(&self, name: &str) -> Option<CameraPose> {
        self.model.image_by_name(name).map(|image| CameraPose(image.cam_from_world))
    }

    /// Camera of an image, a dictionary; None when the model has no image of this name.
    fn camera<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(image) = self.model.image_by_name(name) else { return Ok(None) };
        Ok(Some(dictionary(py, self.model.camera_of(image))?))
    }

    /// Row in `points` of the point that each keypoint of an image observes, `[N]` int64, -1 for none; None when the
    /// model has no image of this name.
    fn point_rows<'py>(&self, py: Python<'py>, name: &str) -> Option<Bound<'py, PyArray1<i64>>> {
        let row = |point: Option<u64>| point.and_then(|id| self.row_of_point.get(&id)).copied().unwrap_or(-1);
        let image = self.model.image_by_name(name)?;
        Some(image.points2d.iter().map(|p| row(p.point)).collect::<Vec<i64>>().into_pyarray(py))
    }

    /// The 3D points, `[N, 3]`, map units.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, self.model.points().iter().map(|p| p.position.coords.into()))
    }

    fn __len__(&self) -> usize {
        self.model.images().len()
    }

    fn __repr__(&self) -> String {
        format!("<ColmapModel of {} images, {} points>", self.model.images().len(), self.model.points().len())
    }
}

/// Undistorts pixels, `[N, 2]`: their positions in the image of the same camera without distortion.
///
/// Raises:
///     InputError: a pixel has no undistorted position.
#[pyfunction]
pub(crate) fn undistort<'py>(
    py: Python<'py>,
    points2d: &Bound<'py, PyAny>,
    camera: &Bound<'py, PyAny>,
) -> Result<Bound<'py, PyArray2<f64>>> {
    let pixels = undistorted(&camera_of(camera)?, arrays::pixels("points2d", points2d)?)?;
    Ok(arrays::matrix(py, pixels.iter().map(|p| [p.u, p.v]))?)
}

/// The camera of a part of an image, with its first pixel at column `x`, row `y`: for passthrough cameras of headsets,
/// whose smaller images are parts of the sensor's.
///
/// Raises:
///     InputError: the part is empty or not within the image, or the camera is invalid.
#[pyfunction]
pub(crate) fn cropped_camera<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    x: u32,
    y: u32,
    width: u32,
    height: u32,
) -> Result<Bound<'py, PyDict>> {
    Ok(dictionary(py, &camera_of(camera)?.cropped(x, y, width, height)?)?)
}
