//! An answer as JSON, the form for people and other programs: of the service, of the program and of every binding.

use serde::{Deserialize, Serialize};
use veiloc_geometry::CameraFromWorld;

use crate::{Answer, AnswerDoubt, AnswerPose, AnswerTimes};

/// Where an image was taken.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnswerDocument {
    /// Version of the document, 1.
    pub version: u32,
    /// `trusted`, without doubts, or `doubtful`: such a pose should not be shown to a user. A query without a pose gets an
    /// error in place of the other fields, with the state `not-found`, or `failed` when it cannot be used.
    pub state: &'static str,
    /// Map to camera; of a session, map to rig. This and the fields up to `rotation_sd_deg` are absent when a doubtful
    /// pose was withheld on request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cam_from_world: Option<PoseDocument>,
    /// The camera centre in the map, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center: Option<[f64; 3]>,
    /// Rows and columns: a rotation vector `w` about the camera's axes (radians), then a vector `v` along them (map
    /// units), of `R' = exp(w) R`, `t' = exp(w) t + v`. `null` on the diagonal where the matches leave a direction
    /// free.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Vec<Vec<Option<f64>>>>))]
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Covariance of `center` in the map's axes, map units squared.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<Vec<Vec<Option<f64>>>>))]
    pub center_covariance: Option<[[f64; 3]; 3]>,
    /// The ±: standard deviation of `center` in its least certain direction, map units; `null` when a direction is free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_sd: Option<f64>,
    /// Standard deviation of the orientation about its least certain axis, degrees; `null` as above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_sd_deg: Option<f64>,
    /// What these deviations include. `map`: errors of the query, its matches and the map; not where the map is on
    /// earth.
    pub sd_includes: &'static str,
    /// Metres of a unit of the map, 1; `null` when the unit is not known.
    pub metres_per_unit: Option<f64>,
    /// Direction of gravity in the map, a unit vector; `null` when the map does not know it.
    pub down: Option<[f64; 3]>,
    /// Use of the query's gravity: `used`, or `unused` when the map does not know the direction; absent when the query
    /// has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity: Option<&'static str>,
    /// Standard deviation of the residuals of the agreeing rows, pixels of the query's camera; absent when the service
    /// does not report it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_px: Option<f64>,
    /// Estimated focal length divided by that of the query, 1 when it was not estimated; absent as above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_scale: Option<f64>,
    /// Estimated principal point minus that of the query, pixels, 0 when it was not estimated; absent as above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub principal_shift_px: Option<[f64; 2]>,
    /// Reasons not to trust the pose; none for a trusted one.
    pub doubts: Vec<AnswerDoubt>,
    /// How strong the evidence is.
    pub confidence: ConfidenceDocument,
    /// Rows of the query that agree with the pose.
    pub inliers: u32,
    /// Rows of the query that were matched to map points.
    pub matches: u32,
    /// Minimal samples drawn.
    pub hypotheses: u32,
    /// Milliseconds of each stage.
    pub ms: AnswerTimes,
}

/// A rigid transform from map coordinates to camera coordinates: `x_camera = R x_map + t`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PoseDocument {
    /// Hamilton unit quaternion `w x y z`.
    pub q: [f64; 4],
    /// Translation, map units.
    pub t: [f64; 3],
}

impl PoseDocument {
    /// The document of a pose.
    pub fn of(pose: &CameraFromWorld) -> Self {
        Self { q: pose.quaternion(), t: (*pose.translation()).into() }
    }

    /// The pose; `None` when the values are invalid.
    pub fn pose(&self) -> Option<CameraFromWorld> {
        CameraFromWorld::from_quaternion(self.q, self.t)
    }
}

/// Evidence for a pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ConfidenceDocument {
    /// Natural logarithm of the evidence against chance.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub log_evidence: f64,
    /// Log likelihood by which the pose beats the best other one; `null` when no other was found.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub margin: f64,
}

impl AnswerDocument {
    /// The document of an answer. JSON has no infinity; it becomes `null`.
    pub fn new(answer: &Answer) -> Self {
        let pose = answer.pose.as_ref();
        Self {
            version: 1,
            state: answer.state().name(),
            cam_from_world: pose.map(|pose| PoseDocument { q: pose.rotation, t: pose.translation }),
            center: pose.map(AnswerPose::center),
            covariance: pose.map(|pose| pose.covariance),
            center_covariance: pose.map(AnswerPose::center_covariance),
            position_sd: pose.map(AnswerPose::position_sd),
            rotation_sd_deg: pose.map(AnswerPose::rotation_sd_deg),
            sd_includes: "map",
            metres_per_unit: answer.map.metres_per_unit,
            down: answer.map.down,
            gravity: answer.gravity.name(),
            noise_px: answer.fit.map(|fit| fit.noise_px),
            focal_scale: answer.fit.map(|fit| fit.focal_scale),
            principal_shift_px: answer.fit.map(|fit| fit.principal_shift_px),
            doubts: answer.doubts.clone(),
            confidence: ConfidenceDocument { log_evidence: answer.log_evidence, margin: answer.margin },
            inliers: answer.inliers,
            matches: answer.matches,
            hypotheses: answer.hypotheses,
            ms: answer.times,
        }
    }
}
