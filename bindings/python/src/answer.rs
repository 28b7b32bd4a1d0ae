//! The answer to a localization query, from a map of this process or from a service.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use veiloc_localization::{Localization, RigLocalization};
use veiloc_map::MapFile;
use veiloc_protocol::{AnswerDoubt, AnswerPose, AnswerTimes};

use crate::arrays;
use crate::pose::CameraPose;

/// The pose of a sealed query, and how far it can be trusted.
#[pyclass(frozen, module = "veiloc")]
#[derive(Clone)]
pub(crate) struct Answer {
    message: veiloc_protocol::Answer,
    /// Names of the map images that were matched, best first; empty in answers of a service.
    #[pyo3(get)]
    retrieved: Vec<String>,
    /// The pose of each camera of a rig; empty for a single query, and in answers of a service.
    #[pyo3(get)]
    frames: Vec<CameraPose>,
}

/// A reason not to trust a pose.
#[pyclass(frozen, get_all, eq, hash, module = "veiloc")]
#[derive(Clone, PartialEq, Eq, Hash)]
pub(crate) struct Doubt {
    /// `"weak-evidence"`, `"ambiguous"`, `"imprecise"`, `"one-sided"` or `"other"`.
    kind: &'static str,
    /// The reason, for people.
    text: String,
}

impl Doubt {
    pub(crate) fn of(doubt: &AnswerDoubt) -> Self {
        Self { kind: doubt.kind.name(), text: doubt.text.clone() }
    }
}

#[pymethods]
impl Doubt {
    fn __str__(&self) -> &str {
        &self.text
    }

    fn __repr__(&self) -> String {
        format!("<Doubt {}: {}>", self.kind, self.text)
    }
}

#[pymethods]
impl Answer {
    /// Pose in the map (of the rig, for a rig); None when it is doubtful and only a trusted pose was requested.
    #[getter]
    fn pose(&self) -> Option<CameraPose> {
        self.message.pose.and_then(|pose| pose.cam_from_world()).map(CameraPose)
    }

    /// Camera centre in the map, `[3]`, map units; None without a pose.
    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.message.pose.map(|pose| arrays::vector3(py, &pose.center().into()))
    }

    /// Covariance, `[6, 6]`: rotation vector in the camera frame (radians), then translation in it (map units); None
    /// without a pose. Relative to the map: how well the map is placed on earth is not part of it.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.message.pose.map(|pose| arrays::matrix(py, pose.covariance.into_iter())).transpose()
    }

    /// Covariance of the centre in the map's axes, `[3, 3]`, map units squared; None without a pose.
    #[getter]
    fn center_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.message.pose.map(|pose| arrays::matrix(py, pose.center_covariance().into_iter())).transpose()
    }

    /// Standard deviation of the position in its least certain direction, map units; infinite without a pose.
    #[getter]
    fn position_sd(&self) -> f64 {
        self.message.position_sd()
    }

    /// Standard deviation of the orientation about its least certain axis, degrees; infinite without a pose.
    #[getter]
    fn rotation_sd_deg(&self) -> f64 {
        self.message.pose.as_ref().map_or(f64::INFINITY, AnswerPose::rotation_sd_deg)
    }

    /// `"trusted"` or `"doubtful"`.
    #[getter]
    fn state(&self) -> &'static str {
        self.message.state().name()
    }

    /// Whether `state` is `"trusted"`.
    #[getter]
    fn trusted(&self) -> bool {
        self.message.trusted()
    }

    /// The reasons to doubt the pose; none for a trusted one.
    #[getter]
    fn doubts(&self) -> Vec<Doubt> {
        self.message.doubts.iter().map(Doubt::of).collect()
    }

    /// Natural logarithm of the evidence for this pose over a chance agreement.
    #[getter]
    fn log_evidence(&self) -> f64 {
        self.message.log_evidence
    }

    /// Log likelihood by which the pose beats the best other one; infinite when no other was found.
    #[getter]
    fn margin(&self) -> f64 {
        self.message.margin
    }

    /// Rows of the query that agree with the pose.
    #[getter]
    fn inliers(&self) -> u32 {
        self.message.inliers
    }

    /// Rows of the query that were matched.
    #[getter]
    fn matches(&self) -> u32 {
        self.message.matches
    }

    /// RANSAC hypotheses that were scored.
    #[getter]
    fn hypotheses(&self) -> u32 {
        self.message.hypotheses
    }

    /// Standard deviation of the inliers, pixels; None when it is not known.
    #[getter]
    fn noise_px(&self) -> Option<f64> {
        self.message.fit.map(|fit| fit.noise_px)
    }

    /// Estimated focal length over that of the query; 1 when it was not estimated, None when it is not known.
    #[getter]
    fn focal_scale(&self) -> Option<f64> {
        self.message.fit.map(|fit| fit.focal_scale)
    }

    /// Estimated principal point minus that of the query, pixels; `(0, 0)` when it was not estimated, None when it is
    /// not known.
    #[getter]
    fn principal_shift_px(&self) -> Option<(f64, f64)> {
        self.message.fit.map(|fit| fit.principal_shift_px.into())
    }

    /// Use of gravity: `"used"`; `"unused"` when the map has no down direction; None when the query has no gravity.
    #[getter]
    fn gravity(&self) -> Option<&'static str> {
        self.message.gravity.name()
    }

    /// Metres of a unit of the map, 1; None when the unit is not known.
    #[getter]
    fn metres_per_unit(&self) -> Option<f64> {
        self.message.map.metres_per_unit
    }

    /// Direction of gravity in the map, `[3]`, a unit vector; None when the map does not know it.
    #[getter]
    fn down<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.message.map.down.map(|down| arrays::vector3(py, &down.into()))
    }

    /// Milliseconds spent in `queue`, `retrieve`, `match` and `pose`.
    #[getter]
    fn ms(&self) -> BTreeMap<&'static str, f64> {
        let AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms } = self.message.times;
        [("queue", queue_ms), ("retrieve", retrieve_ms), ("match", match_ms), ("pose", pose_ms)].into()
    }

    /// The answer as JSON: the document that the service gives, and `veiloc localize --json` for each query.
    fn to_json(&self) -> String {
        self.message.to_json()
    }

    /// The document of `to_json` as a dictionary.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("json")?.call_method1("loads", (self.message.to_json(),))
    }

    fn __bool__(&self) -> bool {
        self.message.pose.is_some()
    }

    fn __repr__(&self) -> String {
        let (answer, state) = (&self.message, self.message.state());
        let Some(pose) = &answer.pose else { return format!("<Answer {state}: withheld>") };
        let ([x, y, z], sd) = (pose.center(), pose.position_sd());
        // As many decimals as the standard deviation justifies, at least three.
        let wanted = if sd.is_finite() && sd > 0.0 { 1.0 - sd.log10().floor() } else { 3.0 };
        let digits = wanted.clamp(3.0, 12.0) as usize;
        format!(
            "<Answer {state}: at ({x:.digits$}, {y:.digits$}, {z:.digits$}) ± {sd:.digits$}, {} of {} matches agree>",
            answer.inliers, answer.matches
        )
    }
}

impl Answer {
    pub(crate) const fn message(&self) -> &veiloc_protocol::Answer {
        &self.message
    }

    /// From a query that a map of this process localized.
    pub(crate) fn of_localization(found: &Localization, map: &MapFile) -> Self {
        let retrieved = found.retrieved.iter().map(|r| map.image(r.image).name().to_owned()).collect();
        Self { message: found.answer(map), retrieved, frames: Vec::new() }
    }

    /// From the queries of a rig; the pose is the rig's.
    pub(crate) fn of_rig(found: &RigLocalization, map: &MapFile) -> Self {
        let frames = found.frames.iter().map(|f| CameraPose(f.cam_from_world)).collect();
        Self { message: found.answer(map), retrieved: Vec::new(), frames }
    }

    /// From the answer of a service.
    pub(crate) const fn of_service(answer: veiloc_protocol::Answer) -> Self {
        Self { message: answer, retrieved: Vec::new(), frames: Vec::new() }
    }
}
