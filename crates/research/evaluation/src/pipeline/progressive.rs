//! Progressive queries: a device sends rows in steps, and stops when the pose is good enough.

use veiloc_geometry::deviations::position_sd;
use veiloc_localization::LocalizeOptions;
use veiloc_pose::State;
use veiloc_protocol::{Profile, SealedQuery, StopCriterion};

use super::served_map::ServedMap;
use super::server::LocalizeResult;

/// The answer to a query, and the amount of sent data.
pub(crate) struct SentResult {
    /// The answer to the last message.
    pub(crate) answer: LocalizeResult,
    /// Rows that the server has received.
    pub(crate) rows: usize,
    /// Bytes of all messages.
    pub(crate) bytes: usize,
    /// Milliseconds of all messages before the last, summed over stages.
    pub(crate) before_ms: f64,
    /// Whether any message was answered with a trusted pose.
    pub(crate) was_trusted: bool,
}

/// How a query is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum QueryTransmission {
    /// All rows at once.
    Whole,
    /// In steps, until the pose meets the criterion (`Client::localize_progressive` of `veiloc-client`).
    Progressive(StopCriterion),
}

/// Sends a sealed query; every message is decoded and localized as if it had crossed a network.
pub(crate) fn send_and_localize(
    served: &ServedMap<'_>,
    bytes: &[u8],
    profile: &Profile,
    transmission: QueryTransmission,
    options: &LocalizeOptions,
) -> SentResult {
    let whole = || {
        let answer = served.localize(bytes, options);
        let rows = SealedQuery::decode(bytes).map_or(0, |query| query.len());
        let was_trusted = answer.state() == State::Trusted;
        SentResult { answer, rows, bytes: bytes.len(), before_ms: 0.0, was_trusted }
    };
    let (QueryTransmission::Progressive(criterion), Ok(query)) = (transmission, SealedQuery::decode(bytes))
    else {
        return whole();
    };
    let mut latest: Option<SentResult> = None;
    for class in query.step_sizes() {
        let Ok(part) = query.first_rows(class, profile) else { return whole() };
        if part.check_sides().is_err() {
            continue;
        }
        let message = part.encode();
        let answer = served.localize(&message, options);
        let trusted = answer.state() == State::Trusted;
        let sd = answer.found.as_ref().map_or(f64::INFINITY, |found| position_sd(&found.covariance));
        let is_met = criterion.is_met(trusted, sd);
        latest = Some(SentResult {
            rows: part.len(),
            bytes: message.len() + latest.as_ref().map_or(0, |a| a.bytes),
            before_ms: latest.as_ref().map_or(0.0, |a| a.before_ms + milliseconds(&a.answer)),
            was_trusted: trusted || latest.as_ref().is_some_and(|a| a.was_trusted),
            answer,
        });
        if is_met {
            break;
        }
    }
    // A device does not send a query with unbalanced anchors whole; the evaluation localizes it anyway.
    latest.unwrap_or_else(whole)
}

fn milliseconds(answer: &LocalizeResult) -> f64 {
    let times = answer.found.as_ref().map(|found| found.times).unwrap_or_default();
    answer.decode_ms + times.retrieve_ms + times.match_ms + times.pose_ms
}
