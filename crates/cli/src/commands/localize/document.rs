//! Results of `veiloc localize`: the JSON document, and the lines of the text output.

use serde::Serialize;
use veiloc_localization::LocalizeError;
use veiloc_protocol::{Answer, AnswerDocument, AnswerState, AnswerTimes};

use crate::output::items::InputError;
use crate::output::position::{position, unit_of};

/// One entry of `queries` for each query.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct LocalizeDocument {
    /// 1.
    version: u32,
    /// The map, as given.
    map: String,
    /// Number of queries with a trusted pose.
    trusted: usize,
    /// Number of queries with a doubtful pose, withheld ones included.
    doubtful: usize,
    /// Number of valid queries without a pose.
    not_found: usize,
    /// Number of queries that cannot be used.
    failed: usize,
    /// The queries, in the order given.
    queries: Vec<QueryDocument>,
}

/// Result of a query.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct QueryDocument {
    /// The sealed query; `-` for stdin; with `--queries` the name of the image in the list.
    file: String,
    #[serde(flatten)]
    result: ResultDocument,
}

/// An answer, as over HTTP, or the reason why there is none.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct ResultDocument {
    #[serde(flatten)]
    none: Option<NoPoseDocument>,
    #[serde(flatten)]
    answer: Option<AnswerDocument>,
}

/// Why a query has no pose.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct NoPoseDocument {
    /// 1.
    version: u32,
    /// `not-found`: the query is valid and no pose was found; `failed`: it cannot be used.
    state: &'static str,
    /// Why there is no pose; absent with an answer.
    error: ErrorDocument,
}

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
}

/// Reason why a query has no pose.
#[derive(Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub(super) enum ErrorDocument {
    NotFound {
        /// Kind of the error, for programs.
        kind: NoPoseKind,
        /// The problem and the remedy, for people.
        message: String,
    },
    Failed(InputError),
}

impl ErrorDocument {
    /// The error of a valid query without a pose.
    pub(super) fn of(error: &LocalizeError) -> Self {
        let kind = match error {
            LocalizeError::WrongProfile { .. } | LocalizeError::Frame { .. } => NoPoseKind::WrongProfile,
            LocalizeError::EmptyMap => NoPoseKind::EmptyMap,
            LocalizeError::NoPose { .. } | LocalizeError::Stopped => NoPoseKind::NoPose,
        };
        Self::NotFound { kind, message: error.to_string() }
    }

    pub(super) fn message(&self) -> &str {
        match self {
            Self::NotFound { message, .. } => message,
            Self::Failed(fault) => &fault.message,
        }
    }

    const fn state(&self) -> &'static str {
        match self {
            Self::NotFound { .. } => "not-found",
            Self::Failed(_) => "failed",
        }
    }
}

/// A query and its result.
pub(super) struct LocalizedQuery {
    /// As in the document.
    pub(super) file: String,
    pub(super) result: Result<Answer, ErrorDocument>,
}

impl LocalizedQuery {
    pub(super) fn answer(&self) -> Option<&Answer> {
        self.result.as_ref().ok()
    }

    /// Returns whether the file could be read.
    pub(super) const fn is_valid(&self) -> bool {
        !matches!(self.result, Err(ErrorDocument::Failed(_)))
    }

    /// Returns whether the query is valid but for another map.
    pub(super) const fn is_refused(&self) -> bool {
        matches!(self.result, Err(ErrorDocument::NotFound { kind: NoPoseKind::WrongProfile, .. }))
    }

    /// Why nothing is shown, for people; `None` for a pose.
    pub(super) fn reason(&self) -> Option<String> {
        reason(&self.result)
    }
}

/// Numbers of queries by state.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StateCounts {
    pub(super) trusted: usize,
    pub(super) doubtful: usize,
    pub(super) withheld: usize,
    pub(super) not_found: usize,
    pub(super) failed: usize,
}

impl StateCounts {
    pub(super) fn of(queries: &[LocalizedQuery]) -> Self {
        let mut counts = Self::default();
        for query in queries {
            match &query.result {
                Ok(answer) if answer.trusted() => counts.trusted += 1,
                Ok(answer) => {
                    counts.doubtful += 1;
                    counts.withheld += usize::from(answer.pose.is_none());
                }
                Err(ErrorDocument::NotFound { .. }) => counts.not_found += 1,
                Err(ErrorDocument::Failed(_)) => counts.failed += 1,
            }
        }
        counts
    }

    /// Number of queries with a pose.
    pub(super) const fn with_pose(&self) -> usize {
        self.trusted + self.doubtful - self.withheld
    }
}

impl LocalizeDocument {
    pub(super) fn new(map: String, queries: &[LocalizedQuery]) -> Self {
        let StateCounts { trusted, doubtful, not_found, failed, .. } = StateCounts::of(queries);
        let document = |query: &LocalizedQuery| QueryDocument {
            file: query.file.clone(),
            result: ResultDocument::of(&query.result),
        };
        let queries = queries.iter().map(document).collect();
        Self { version: 1, map, trusted, doubtful, not_found, failed, queries }
    }
}

impl ResultDocument {
    pub(super) fn of(result: &Result<Answer, ErrorDocument>) -> Self {
        let none =
            |error: &ErrorDocument| NoPoseDocument { version: 1, state: error.state(), error: error.clone() };
        Self { none: result.as_ref().err().map(none), answer: result.as_ref().ok().map(AnswerDocument::new) }
    }
}

/// Why nothing is shown, for people; `None` for a pose.
pub(super) fn reason(result: &Result<Answer, ErrorDocument>) -> Option<String> {
    match result {
        Ok(answer) if answer.pose.is_some() => None,
        Ok(answer) => Some(format!(
            "its pose is withheld: {}; send another frame of the same session, or first move by at least one step",
            doubts(answer)
        )),
        Err(error) => Some(error.message().to_owned()),
    }
}

/// The doubts of an answer in one line; empty for a trusted one.
pub(crate) fn doubts(answer: &Answer) -> String {
    answer.doubts.iter().map(|doubt| doubt.text.as_str()).collect::<Vec<_>>().join("; ")
}

/// An answer in one line, without its state: position, agreeing matches, time and doubts.
pub(crate) fn answer_text(answer: &Answer) -> String {
    let AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms } = answer.times;
    let total = queue_ms + retrieve_ms + match_ms + pose_ms;
    let place = answer.pose.as_ref().map_or_else(
        || "its pose is withheld".to_owned(),
        |pose| {
            let unit = unit_of(answer.map.metres_per_unit.is_some());
            format!("{} {unit}", position(pose.center(), pose.position_sd()))
        },
    );
    let doubts = if answer.trusted() { String::new() } else { format!("  {}", doubts(answer)) };
    format!("{place}  {} of {} matches agree  {total:.0} ms{doubts}", answer.inliers, answer.matches)
}

/// One line for each query that was answered; unusable files are reported on stderr.
pub(super) fn table(queries: &[LocalizedQuery]) -> String {
    use std::fmt::Write as _;
    let answered = || queries.iter().filter(|query| query.is_valid());
    let width = answered().map(|query| query.file.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for query in answered() {
        let line = match (&query.result, query.reason()) {
            (Ok(answer), None) => format!("{:<9}  {}", answer.state(), answer_text(answer)),
            (Ok(_), Some(why)) => format!("{:<9}  {why}", AnswerState::Doubtful),
            (Err(error), _) => format!("{:<9}  {}", error.state(), error.message()),
        };
        let _ = writeln!(text, "{:<width$}  {line}", query.file);
    }
    text
}
