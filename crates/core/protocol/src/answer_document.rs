//! An answer as JSON, the form for people and other programs, with the fields that `docs/reference/http.md` lists.

use serde::Serialize;

use crate::{Answer, AnswerDoubt, AnswerPose, AnswerTimes};

/// Where an image was taken.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AnswerDocument {
    /// Version of the document, 1.
    pub version: u32,
    /// The map that answered.
    pub map: String,
    /// `trusted` or `doubtful`. A query without a pose gets an error response instead of this document.
    pub state: &'static str,
    /// Map to camera. This and the fields up to `position_sd` are absent when a doubtful pose was withheld on request.
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
    /// Standard deviation of `center` in its least certain direction, map units; `null` when a direction is free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_sd: Option<f64>,
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
    /// Whether there are no doubts about the pose. A pose that is not trusted should not be shown to a user.
    pub trusted: bool,
    /// Reasons not to trust the pose; may be empty.
    pub doubts: Vec<DoubtDocument>,
    /// How strong the evidence is.
    pub confidence: ConfidenceDocument,
    /// Rows of the query that agree with the pose.
    pub inliers: u32,
    /// Rows of the query that were matched to map points.
    pub matches: u32,
    /// Minimal samples drawn.
    pub hypotheses: u32,
    /// Milliseconds of each stage.
    pub ms: StageDocument,
}

/// A rigid transform from map coordinates to camera coordinates: `x_camera = R x_map + t`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PoseDocument {
    /// Hamilton unit quaternion `w x y z`.
    pub q: [f64; 4],
    /// Translation, map units.
    pub t: [f64; 3],
}

/// A reason not to trust a pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DoubtDocument {
    /// `weak-evidence`, `ambiguous`, `imprecise`, `one-sided` or `other`.
    pub kind: &'static str,
    /// Human-readable.
    pub text: String,
}

/// Evidence for a pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ConfidenceDocument {
    /// Natural logarithm of the evidence against chance.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub log_evidence: f64,
    /// Log likelihood by which the pose beats the best other one; `null` when no other was found.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub margin: f64,
}

/// Milliseconds of each stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StageDocument {
    /// Waiting for a worker.
    pub queue: f64,
    /// Finding similar map images.
    pub retrieve: f64,
    /// Matching descriptors.
    #[serde(rename = "match")]
    pub matching: f64,
    /// Estimating the pose.
    pub pose: f64,
}

impl AnswerDocument {
    /// The answer of the map with this name. JSON has no infinity; it becomes `null`.
    pub fn new(map: &str, answer: &Answer) -> Self {
        let AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms } = answer.times;
        let doubt = |d: &AnswerDoubt| DoubtDocument { kind: d.kind.name(), text: d.text.clone() };
        let pose = answer.pose.as_ref();
        Self {
            version: 1,
            map: map.to_owned(),
            state: answer.state().name(),
            cam_from_world: pose.map(|pose| PoseDocument { q: pose.rotation, t: pose.translation }),
            center: pose.map(|pose| pose.center),
            covariance: pose.map(|pose| pose.covariance),
            center_covariance: pose.map(|pose| pose.center_covariance),
            position_sd: pose.map(AnswerPose::position_sd),
            noise_px: answer.fit.map(|fit| fit.noise_px),
            focal_scale: answer.fit.map(|fit| fit.focal_scale),
            principal_shift_px: answer.fit.map(|fit| fit.principal_shift_px),
            trusted: answer.trusted,
            doubts: answer.doubts.iter().map(doubt).collect(),
            confidence: ConfidenceDocument { log_evidence: answer.log_evidence, margin: answer.margin },
            inliers: answer.inliers,
            matches: answer.matches,
            hypotheses: answer.hypotheses,
            ms: StageDocument { queue: queue_ms, retrieve: retrieve_ms, matching: match_ms, pose: pose_ms },
        }
    }
}
