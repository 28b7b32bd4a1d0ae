//! The answer to a localization query, from a map of this process or from a service.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::{GravityUse, Localization, RigLocalization};
use veiloc_map::MapFile;
use veiloc_pose::Confidence;

use crate::arrays;
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// The pose of a sealed query, and how far it can be trusted.
#[pyclass(frozen, module = "veiloc")]
#[derive(Clone)]
pub(crate) struct Answer {
    pose: Option<CameraFromWorld>,
    covariance: [[f64; 6]; 6],
    /// Standard deviation of the position, map units.
    #[pyo3(get)]
    position_sd: f64,
    /// `"trusted"` or `"doubtful"`.
    #[pyo3(get)]
    state: String,
    /// The reasons to doubt the pose, as text.
    #[pyo3(get)]
    doubts: Vec<String>,
    /// Natural logarithm of the evidence for this pose over a chance agreement.
    #[pyo3(get)]
    log_evidence: f64,
    /// Rows of the query that agree with the pose.
    #[pyo3(get)]
    inliers: usize,
    /// Rows of the query that were matched.
    #[pyo3(get)]
    matches: usize,
    /// RANSAC hypotheses that were scored.
    #[pyo3(get)]
    iterations: usize,
    /// Standard deviation of the inliers, pixels; None when it is not known.
    #[pyo3(get)]
    noise_px: Option<f64>,
    /// Estimated focal length over that of the query; 1 when it was not estimated, None when it is not known.
    #[pyo3(get)]
    focal_scale: Option<f64>,
    /// Estimated principal point minus that of the query, pixels; `(0, 0)` when it was not estimated, None when it is
    /// not known.
    #[pyo3(get)]
    principal_shift_px: Option<(f64, f64)>,
    /// Use of gravity: `"used"`; `"unused"` when the map has no down direction; None when the query has no gravity.
    #[pyo3(get)]
    gravity: Option<&'static str>,
    /// Names of the map images that were matched, best first; empty in answers of a service.
    #[pyo3(get)]
    retrieved: Vec<String>,
    /// Milliseconds spent in `retrieve`, `match` and `pose`.
    #[pyo3(get)]
    ms: BTreeMap<&'static str, f64>,
    /// The pose of each camera of a rig; empty for a single query.
    #[pyo3(get)]
    frames: Vec<CameraPose>,
}

#[pymethods]
impl Answer {
    /// Pose in the map (of the rig, for a rig); None when it is doubtful and only a trusted pose was requested.
    #[getter]
    fn pose(&self) -> Option<CameraPose> {
        self.pose.map(CameraPose)
    }

    /// Camera centre in the map, `[3]`, map units; None without a pose.
    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.pose.map(|pose| arrays::vector3(py, &pose.center().coords))
    }

    /// Covariance, `[6, 6]`: rotation vector in the camera frame (radians), then translation in it (map units).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, self.covariance.into_iter())
    }

    /// Covariance of the centre in the map's axes, `[3, 3]`, map units squared; None without a pose.
    #[getter]
    fn center_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let of = |pose: CameraFromWorld| pose.center_covariance(&self.covariance);
        self.pose.map(|pose| arrays::matrix(py, of(pose).into_iter())).transpose()
    }

    /// Whether `state` is `"trusted"`.
    #[getter]
    fn trusted(&self) -> bool {
        self.state == "trusted"
    }

    fn __bool__(&self) -> bool {
        self.pose.is_some()
    }

    fn __repr__(&self) -> String {
        let Some(pose) = &self.pose else { return format!("<Answer {}: withheld>", self.state) };
        let c = pose.center().coords;
        let sd = self.position_sd;
        // As many decimals as the standard deviation justifies, at least three.
        let wanted = if sd.is_finite() && sd > 0.0 { 1.0 - sd.log10().floor() } else { 3.0 };
        let digits = wanted.clamp(3.0, 12.0) as usize;
        format!(
            "<Answer {}: at ({:.digits$}, {:.digits$}, {:.digits$}) ± {sd:.digits$}, {} of {} matches agree>",
            self.state, c.x, c.y, c.z, self.inliers, self.matches
        )
    }
}

impl Answer {
    fn with_pose(pose: CameraFromWorld, covariance: &[[f64; 6]; 6], confidence: &Confidence) -> Self {
        Self {
            pose: Some(pose),
            covariance: *covariance,
            position_sd: confidence.center_sd,
            state: confidence.state().to_string(),
            doubts: confidence.doubts().iter().map(ToString::to_string).collect(),
            log_evidence: confidence.log_evidence,
            inliers: 0,
            matches: 0,
            iterations: 0,
            noise_px: None,
            focal_scale: None,
            principal_shift_px: None,
            gravity: None,
            retrieved: Vec::new(),
            ms: BTreeMap::new(),
            frames: Vec::new(),
        }
    }

    /// From a query that a map of this process localized.
    pub(crate) fn of_localization(found: &Localization, map: &MapFile) -> Self {
        Self {
            inliers: found.inliers,
            matches: found.matches,
            iterations: found.hypotheses,
            noise_px: Some(found.noise_px),
            focal_scale: Some(found.focal_scale),
            principal_shift_px: Some(found.principal_shift_px.into()),
            gravity: match found.gravity {
                GravityUse::NotProvided => None,
                GravityUse::Used => Some("used"),
                GravityUse::UnknownInMap => Some("unused"),
            },
            retrieved: found.retrieved.iter().map(|r| map.image(r.image).name().to_owned()).collect(),
            ms: times(found.times.retrieve_ms, found.times.match_ms, found.times.pose_ms),
            ..Self::with_pose(found.cam_from_world, &found.covariance, &found.confidence)
        }
    }

    /// From the queries of a rig; the pose is the rig's.
    pub(crate) fn of_rig(found: &RigLocalization) -> Self {
        let rig = &found.rig_from_world;
        let sum = |count: fn(&veiloc_localization::FrameLocalization) -> usize| {
            found.frames.iter().map(count).sum()
        };
        Self {
            inliers: sum(|f| f.inliers),
            matches: sum(|f| f.matches),
            iterations: found.hypotheses,
            noise_px: found.noise_px(),
            focal_scale: found.focal_scale(),
            ms: times(found.times.retrieve_ms, found.times.match_ms, found.times.pose_ms),
            frames: found.frames.iter().map(|f| CameraPose(f.cam_from_world)).collect(),
            ..Self::with_pose(
                CameraFromWorld::new(*rig.rotation(), *rig.translation()),
                &found.covariance,
                &found.confidence,
            )
        }
    }

    /// From the answer of a service.
    pub(crate) fn of_service(answer: &veiloc_protocol::Answer) -> Result<Self> {
        let pose = answer.pose.as_ref();
        let refused = || BindingError::other("the service sent an invalid pose");
        let found =
            pose.map(|p| CameraFromWorld::from_quaternion(p.rotation, p.translation).ok_or_else(refused));
        Ok(Self {
            pose: found.transpose()?,
            covariance: pose.map_or([[f64::INFINITY; 6]; 6], |p| p.covariance),
            position_sd: pose.map_or(f64::INFINITY, veiloc_protocol::AnswerPose::position_sd),
            state: answer.state().to_string(),
            doubts: answer.doubts.iter().map(|d| d.text.clone()).collect(),
            log_evidence: answer.log_evidence,
            inliers: answer.inliers as usize,
            matches: answer.matches as usize,
            iterations: answer.hypotheses as usize,
            noise_px: answer.fit.map(|fit| fit.noise_px),
            focal_scale: answer.fit.map(|fit| fit.focal_scale),
            principal_shift_px: answer.fit.map(|fit| fit.principal_shift_px.into()),
            gravity: None,
            retrieved: Vec::new(),
            ms: times(answer.times.retrieve_ms, answer.times.match_ms, answer.times.pose_ms),
            frames: Vec::new(),
        })
    }
}

fn times(retrieve: f64, matching: f64, pose: f64) -> BTreeMap<&'static str, f64> {
    [("retrieve", retrieve), ("match", matching), ("pose", pose)].into()
}
