//! The transform between the map and odometry, from several answers.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::PyArray2;
use pyo3::prelude::*;
use veiloc_ar::{AlignmentOptions, CameraFromAr, check_unit};
use veiloc_geometry::CameraFromWorld;

use crate::answer::Answer;
use crate::arrays;
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// The transform from the map to a frame that a device tracks itself in (odometry, an AR session), from several answers.
///
/// The last answers are compared; the largest set that agrees is averaged, and everything else moves nothing: not a wrong answer,
/// and not a doubtful one. After a jump of the odometry, new answers that agree take over.
///
/// Args:
///     metres_per_unit: metres of a unit of the map. Default: as the answers state it.
///     drift: standard deviation of the odometry's position after a metre of path, metres.
///     rotation_drift_deg: the same of its rotation, degrees.
///     position_floor: standard deviation of the position along each axis that answers of one place share, metres.
///     rotation_floor_deg: the same of the rotation about each axis, degrees.
///
/// Raises:
///     InputError: a number is negative or not finite, or `metres_per_unit` is 0.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Alignment(Mutex<veiloc_ar::Alignment>);

impl Alignment {
    fn locked(&self) -> MutexGuard<'_, veiloc_ar::Alignment> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn in_odometry(pose: &CameraPose) -> CameraFromAr {
    CameraFromAr::new(*pose.0.rotation(), *pose.0.translation())
}

#[pymethods]
impl Alignment {
    #[new]
    #[pyo3(signature = (*, metres_per_unit=None, drift=0.01, rotation_drift_deg=0.05, position_floor=0.02,
                        rotation_floor_deg=0.2))]
    fn new(
        metres_per_unit: Option<f64>,
        drift: f64,
        rotation_drift_deg: f64,
        position_floor: f64,
        rotation_floor_deg: f64,
    ) -> Result<Self> {
        for sd in [drift, rotation_drift_deg, position_floor, rotation_floor_deg] {
            if !(sd.is_finite() && sd >= 0.0) {
                return Err(BindingError::input(format_args!(
                    "a standard deviation is {sd}; it must be 0 or more"
                )));
            }
        }
        let mut options = AlignmentOptions::default()
            .with_drift(drift, rotation_drift_deg)
            .with_floors(position_floor, rotation_floor_deg);
        if let Some(metres) = metres_per_unit {
            options = options.with_metres_per_unit(check_unit(metres).map_err(BindingError::input)?);
        }
        Ok(Self(Mutex::new(veiloc_ar::Alignment::new(options))))
    }

    /// Takes an answer, and the pose of the camera (or rig) in the odometry frame when it took the image, not its pose now.
    ///
    /// Args:
    ///     answer: the answer to the sealed image.
    ///     cam_from_odom: pose of the camera in the odometry frame, metres.
    ///
    /// Returns:
    ///     What it did: `"used"`; `"contradicts"`: trusted, and contradicts the transform; `"doubtful-agrees"`, `"doubtful"`: nothing
    ///     changed; `"no-pose"`; `"unknown-unit"`: it does not state the unit of the map, and none was given.
    fn add(&self, answer: &Answer, cam_from_odom: &CameraPose) -> &'static str {
        self.locked().add(answer.message(), &in_odometry(cam_from_odom)).name()
    }

    /// Takes the pose of the camera in the odometry frame between answers: the length of its path says how far the odometry may have
    /// drifted.
    fn moved(&self, cam_from_odom: &CameraPose) {
        self.locked().moved(&in_odometry(cam_from_odom));
    }

    /// Forgets all answers, as when the odometry starts again.
    fn reset(&self) {
        self.locked().reset();
    }

    /// `"searching"`: no trusted answer yet; `"tentative"`: no two answers agree; `"aligned"`.
    #[getter]
    fn state(&self) -> &'static str {
        self.locked().state().name()
    }

    /// `x_odom = R x_map + t`, both in metres; None before the first trusted answer.
    #[getter]
    fn odom_from_map(&self) -> Option<CameraPose> {
        let alignment = self.locked();
        let transform = alignment.aligned()?.ar_from_map;
        Some(CameraPose(CameraFromWorld::new(*transform.rotation(), *transform.translation())))
    }

    /// Covariance of `odom_from_map`, `[6, 6]`: rotation vector in the odometry frame (radians), then translation in it (metres);
    /// None before the first trusted answer.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.locked().aligned().map(|known| arrays::matrix(py, known.covariance.into_iter())).transpose()
    }

    /// Answers that the transform is the average of.
    #[getter]
    fn used(&self) -> usize {
        self.locked().aligned().map_or(0, |known| known.used)
    }

    /// Trusted answers that contradict it, among those that are remembered.
    #[getter]
    fn contradicting(&self) -> usize {
        self.locked().aligned().map_or(0, |known| known.contradicting)
    }

    /// Pose of the camera in the map, map units, from its pose in the odometry frame now; None before the first trusted answer.
    fn cam_from_map(&self, cam_from_odom: &CameraPose) -> Option<CameraPose> {
        self.locked().cam_from_map(&in_odometry(cam_from_odom)).map(CameraPose)
    }

    fn __repr__(&self) -> String {
        format!(
            "<Alignment {}, {} answers used, {} contradict>",
            self.state(),
            self.used(),
            self.contradicting()
        )
    }
}
