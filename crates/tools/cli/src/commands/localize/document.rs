//! Results of `veiloc localize`: the JSON document, and the lines of the text output.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_evaluation::results::PoseDocument;
use veiloc_localization::{GravityUse, Localization, LocalizeError};
use veiloc_pose::{Confidence, State};

use crate::items::InputError;
use crate::output::position::position;

/// The document of `veiloc localize --json`.
#[derive(Serialize)]
pub(super) struct LocalizeDocument {
    pub(super) version: u32,
    pub(super) map: String,
    pub(super) localized: usize,
    pub(super) not_localized: usize,
    pub(super) failed: usize,
    pub(super) queries: Vec<QueryDocument>,
}

/// Result of a query.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum LocalizeStatus {
    /// It has a pose; `trusted` says whether the pose is trusted.
    Localized,
    /// The query is valid, and no pose was found.
    NotLocalized,
    /// The file cannot be used.
    Failed,
}

/// `gravity` of a query whose gravity was not used, because the map does not know the direction of gravity.
pub(super) const UNUSED_GRAVITY: &str = "unused";

/// Reason why a query has no pose, for programs.
#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum NoPoseKind {
    /// Too few inliers.
    NoPose,
    /// The query was sealed for another map, or for an older version of this one.
    WrongProfile,
    /// The map has no points.
    EmptyMap,
    /// The pose is doubtful, and only trusted poses were requested.
    Withheld,
}

/// Reason why a query has no pose.
#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum ErrorDocument {
    NotLocalized { kind: NoPoseKind, message: String },
    Failed(InputError),
}

impl ErrorDocument {
    pub(super) fn message(&self) -> &str {
        match self {
            Self::NotLocalized { message, .. } => message,
            Self::Failed(fault) => &fault.message,
        }
    }
}

#[derive(Serialize)]
pub(super) struct QueryDocument {
    pub(super) file: String,
    pub(super) status: LocalizeStatus,
    /// `trusted`, `doubtful` or `not-found`.
    pub(super) state: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cam_from_world: Option<PoseDocument>,
    /// Projection centre in the map, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) center: Option<[f64; 3]>,
    /// Standard deviation of the centre in its least certain direction, map units: the ± of the text output.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) position_sd: Option<f64>,
    /// Row-major; a rotation vector `w` about the camera's axes (radians), then a vector `v` along them (map units), of
    /// `R' = exp(w) R`, `t' = exp(w) t + v`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) covariance: Option<[[f64; 6]; 6]>,
    /// Standard deviation estimated from the inliers, pixels of the query's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) noise_px: Option<f64>,
    /// Estimated focal length divided by the one in the query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) focal_scale: Option<f64>,
    /// How the direction of gravity in the query was used; absent if the query has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gravity: Option<&'static str>,
    /// Whether the pose is trusted, and the reasons for doubt.
    pub(super) trusted: bool,
    pub(super) doubts: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) confidence: Option<ConfidenceDocument>,
    pub(super) inliers: usize,
    pub(super) matches: usize,
    pub(super) hypotheses: usize,
    pub(super) ms: BTreeMap<&'static str, f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) error: Option<ErrorDocument>,
}

/// Evidence for and against a pose; see `veiloc_pose::Confidence`.
#[derive(Serialize)]
pub(super) struct ConfidenceDocument {
    /// Natural logarithm of the evidence against a chance pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    log_evidence: Option<f64>,
    /// Difference in log likelihood to the best other pose; absent if no other was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    margin: Option<f64>,
    /// Standard deviation of the camera centre in its least certain direction, map units.
    #[serde(skip_serializing_if = "Option::is_none")]
    center_sd: Option<f64>,
    /// Standard deviation of the orientation about its least certain axis, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation_sd_deg: Option<f64>,
}

impl ConfidenceDocument {
    pub(super) fn of(confidence: &Confidence) -> Self {
        let finite = |x: f64| x.is_finite().then_some(x);
        Self {
            log_evidence: finite(confidence.log_evidence),
            margin: finite(confidence.margin),
            center_sd: finite(confidence.center_sd),
            rotation_sd_deg: finite(confidence.rotation_sd_deg),
        }
    }
}

impl QueryDocument {
    /// Returns whether it has a doubtful pose.
    pub(super) fn is_doubtful(&self) -> bool {
        self.status == LocalizeStatus::Localized && !self.trusted
    }

    /// Returns whether the query is valid but for another map.
    pub(super) fn is_refused(&self) -> bool {
        matches!(self.error, Some(ErrorDocument::NotLocalized { kind: NoPoseKind::WrongProfile, .. }))
    }
}

pub(super) fn not_localized(kind: NoPoseKind, error: &LocalizeError) -> ErrorDocument {
    ErrorDocument::NotLocalized { kind, message: error.to_string() }
}

pub(super) fn localized_query(file: String, found: &Localization) -> QueryDocument {
    let pose = &found.cam_from_world;
    let c = pose.center().coords;
    QueryDocument {
        file,
        status: LocalizeStatus::Localized,
        state: name_of(found.state),
        cam_from_world: Some(PoseDocument::of(pose)),
        center: Some([c.x, c.y, c.z]),
        position_sd: Some(found.confidence.center_sd),
        covariance: Some(found.covariance),
        noise_px: Some(found.noise_px),
        focal_scale: Some(found.focal_scale),
        gravity: match found.gravity {
            GravityUse::NotProvided => None,
            GravityUse::Used => Some("used"),
            GravityUse::UnknownInMap => Some(UNUSED_GRAVITY),
        },
        trusted: found.confidence.is_trusted(),
        doubts: found.confidence.doubts().iter().map(ToString::to_string).collect(),
        confidence: Some(ConfidenceDocument::of(&found.confidence)),
        inliers: found.inliers,
        matches: found.matches,
        hypotheses: found.hypotheses,
        ms: [
            ("retrieve", found.times.retrieve_ms),
            ("match", found.times.match_ms),
            ("pose", found.times.pose_ms),
        ]
        .into(),
        error: None,
    }
}

/// Removes the pose and all statements on it, except the reasons for doubt.
pub(super) fn withheld(query: QueryDocument) -> QueryDocument {
    let message = format!(
        "its pose is withheld: {}; send another frame of the same session, or first move by at least one \
         step",
        query.doubts.join("; ")
    );
    QueryDocument {
        status: LocalizeStatus::NotLocalized,
        cam_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        error: Some(ErrorDocument::NotLocalized { kind: NoPoseKind::Withheld, message }),
        ..query
    }
}

pub(super) const fn name_of(state: State) -> &'static str {
    match state {
        State::Trusted => "trusted",
        State::Doubtful => "doubtful",
        State::NotFound => "not-found",
    }
}

pub(super) fn failed_query(file: String, error: ErrorDocument) -> QueryDocument {
    let status = match error {
        ErrorDocument::NotLocalized { .. } => LocalizeStatus::NotLocalized,
        ErrorDocument::Failed(_) => LocalizeStatus::Failed,
    };
    QueryDocument {
        file,
        status,
        state: name_of(State::NotFound),
        cam_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        noise_px: None,
        focal_scale: None,
        gravity: None,
        trusted: false,
        doubts: Vec::new(),
        confidence: None,
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        ms: BTreeMap::new(),
        error: Some(error),
    }
}

/// One line for each query that was answered; unusable files are reported on stderr.
pub(super) fn table(document: &LocalizeDocument) -> String {
    use std::fmt::Write as _;
    let answered = || document.queries.iter().filter(|q| q.status != LocalizeStatus::Failed);
    let width = answered().map(|q| q.file.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for q in answered() {
        let state = q.state;
        let _ = match (&q.center, &q.error) {
            (Some(center), _) => {
                let sd = q.position_sd.unwrap_or(f64::INFINITY);
                let total: f64 = q.ms.values().sum();
                writeln!(
                    text,
                    "{:<width$}  {state:<9}  {}  {} of {} matches agree  {total:.0} ms{}",
                    q.file,
                    position(*center, sd),
                    q.inliers,
                    q.matches,
                    if q.trusted { String::new() } else { format!("  {}", q.doubts.join("; ")) },
                )
            }
            (None, error) => {
                let why = error.as_ref().map_or("not localized", ErrorDocument::message);
                writeln!(text, "{:<width$}  {state:<9}  {why}", q.file)
            }
        };
    }
    text
}
