//! Results of `veiloc localize`: the JSON document, and the lines of the text output.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_evaluation::results::PoseDocument;
use veiloc_localization::{GravityUse, Localization, LocalizeError};
use veiloc_pose::{Confidence, State};

use crate::output::items::InputError;
use crate::output::position::{position, unit_of};

/// One entry of `queries` for each query.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct LocalizeDocument {
    /// 2.
    pub(super) version: u32,
    /// The map, as given.
    pub(super) map: String,
    /// Whether map units are metres; false if not known.
    pub(super) is_metric: bool,
    /// Number of queries with a pose.
    pub(super) localized: usize,
    /// Number of valid queries without a pose.
    pub(super) not_localized: usize,
    /// Number of queries that cannot be used.
    pub(super) failed: usize,
    /// The queries, in the order given.
    pub(super) queries: Vec<QueryDocument>,
}

/// Result of a query.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub(super) enum ErrorDocument {
    NotLocalized {
        /// Kind of the error, for programs.
        kind: NoPoseKind,
        /// The problem and the remedy, for people.
        message: String,
    },
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

/// Result of a query.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct QueryDocument {
    /// The sealed query; `-` for stdin; with `--queries` the name of the image in the list.
    pub(super) file: String,
    /// Whether there is a pose. Whether it is trusted is in `state`.
    pub(super) status: LocalizeStatus,
    /// State of the pose: `trusted`, `doubtful` or `not-found`.
    pub(super) state: &'static str,
    /// The pose; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cam_from_world: Option<PoseDocument>,
    /// Camera centre in the map, map units; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) center: Option<[f64; 3]>,
    /// Standard deviation of the centre in its least certain direction, map units: the ± of the text output; null when
    /// a direction is unconstrained; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) position_sd: Option<f64>,
    /// Covariance of the pose, see *Covariance*; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) covariance: Option<[[f64; 6]; 6]>,
    /// Standard deviation of the inliers' residuals, pixels of the query's camera: across the line, for points along
    /// each axis. Much more than 1 means that map, camera or query are worse than expected. Absent when nothing was
    /// found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) noise_px: Option<f64>,
    /// Estimated focal length divided by that of the query; 1 when it was not estimated; absent when nothing was
    /// found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) focal_scale: Option<f64>,
    /// Estimated principal point minus that of the query, pixels; absent when it was not estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) principal_shift_px: Option<[f64; 2]>,
    /// Use of the query's gravity: `used`, or `unused` when the map does not know the direction of gravity; absent if
    /// the query has none, or nothing was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gravity: Option<&'static str>,
    /// Whether the pose is trusted; false without a pose.
    pub(super) trusted: bool,
    /// Reasons to doubt the pose, for people.
    pub(super) doubts: Vec<String>,
    /// Evidence for and against the pose; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) confidence: Option<ConfidenceDocument>,
    /// Number of matches that agree with the pose; 0 without a pose.
    pub(super) inliers: usize,
    /// Number of matches between query and map.
    pub(super) matches: usize,
    /// Number of hypotheses.
    pub(super) hypotheses: usize,
    /// Milliseconds of the stages `retrieve`, `match` and `pose`.
    pub(super) ms: BTreeMap<&'static str, f64>,
    /// Why there is no pose; absent with a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) error: Option<ErrorDocument>,
}

/// Evidence for and against a pose; see `veiloc_pose::Confidence`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct ConfidenceDocument {
    /// Natural logarithm of the evidence against chance, by map point; absent when it is infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    log_evidence: Option<f64>,
    /// Difference in log likelihood to the best other pose, nats; absent if no other was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    margin: Option<f64>,
    /// Log evidence of another pose from the matches that do not agree with this one; absent if they support none.
    #[serde(skip_serializing_if = "Option::is_none")]
    rival_log_evidence: Option<f64>,
    /// Distance from the position given with `--near`, in standard deviations of both; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_deviation: Option<f64>,
    /// `position_sd`; absent when it is infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    center_sd: Option<f64>,
    /// Standard deviation of the orientation about its least certain axis, degrees; absent when it is infinite.
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation_sd_deg: Option<f64>,
}

impl ConfidenceDocument {
    pub(super) fn of(confidence: &Confidence) -> Self {
        let finite = |x: f64| x.is_finite().then_some(x);
        Self {
            log_evidence: finite(confidence.log_evidence),
            margin: finite(confidence.margin),
            rival_log_evidence: confidence.rival_log_evidence,
            position_deviation: confidence.position_deviation.and_then(finite),
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
        principal_shift_px: (found.principal_shift_px != [0.0; 2]).then_some(found.principal_shift_px),
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
        principal_shift_px: None,
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
    let unit = unit_of(document.is_metric);
    let mut text = String::new();
    for q in answered() {
        let state = q.state;
        let _ = match (&q.center, &q.error) {
            (Some(center), _) => {
                let sd = q.position_sd.unwrap_or(f64::INFINITY);
                let total: f64 = q.ms.values().sum();
                writeln!(
                    text,
                    "{:<width$}  {state:<9}  {} {unit}  {} of {} matches agree  {total:.0} ms{}",
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
