//! An answer as JSON, the form that people and other programs read: field by field what `docs/service.md` lists.

use serde::Serialize;

use crate::{Answer, AnswerDoubt, AnswerTimes};

/// Where an image was taken.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AnswerDocument {
    /// 1.
    pub version: u32,
    /// The map that answered.
    pub map: String,
    /// Map to camera.
    pub cam_from_world: PoseDocument,
    /// Where the camera is in the map, map units.
    pub center: [f64; 3],
    /// Rows and columns: rotation vector about the camera's axes (radians), then translation (map units). `null` on
    /// the diagonal where the matches leave a direction free.
    #[cfg_attr(feature = "openapi", schema(value_type = Vec<Vec<Option<f64>>>))]
    pub covariance: [[f64; 6]; 6],
    /// Covariance of `center` in the map's axes, map units squared.
    #[cfg_attr(feature = "openapi", schema(value_type = Vec<Vec<Option<f64>>>))]
    pub center_covariance: [[f64; 3]; 3],
    /// Whether nothing speaks against the pose. A pose that is not trusted should not be shown to a user.
    pub trusted: bool,
    /// What does.
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
    /// `weak-evidence`, `ambiguous`, `loosely-held`, `one-sided` or `other`.
    pub kind: &'static str,
    /// For people.
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
        Self {
            version: 1,
            map: map.to_owned(),
            cam_from_world: PoseDocument { q: answer.rotation, t: answer.translation },
            center: answer.center,
            covariance: answer.covariance,
            center_covariance: answer.center_covariance,
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
