//! A query asked in steps, as a device does it that sends no more rows than a trusted pose takes.

use veiloc_geometry::deviations::position_sd;
use veiloc_localization::LocalizeOptions;
use veiloc_pose::State;
use veiloc_protocol::{Enough, Profile, SealedQuery};

use super::ask::Answer;
use super::served::Served;

/// The answer to a query, and what was sent for it.
pub(crate) struct Asked {
    /// The answer to the last message.
    pub(crate) answer: Answer,
    /// Rows that the server has seen.
    pub(crate) rows: usize,
    /// Bytes of all messages.
    pub(crate) bytes: usize,
    /// Milliseconds of the messages before the last, the stages of each added up.
    pub(crate) before_ms: f64,
    /// Whether any message was answered with a trusted pose.
    pub(crate) was_trusted: bool,
}

/// How a query leaves the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sending {
    /// All rows at once.
    Whole,
    /// Step by step, until a pose is enough (`Client::localize_progressive` of `veiloc-client`).
    Progressive(Enough),
}

/// Sends a sealed query, every message decoded and localized as if it had crossed a network.
pub(crate) fn send_and_ask(
    served: &Served<'_>,
    bytes: &[u8],
    profile: &Profile,
    sending: Sending,
    options: &LocalizeOptions,
) -> Asked {
    let whole = || {
        let answer = served.ask(bytes, options);
        let rows = SealedQuery::decode(bytes).map_or(0, |query| query.len());
        let was_trusted = answer.state() == State::Trusted;
        Asked { answer, rows, bytes: bytes.len(), before_ms: 0.0, was_trusted }
    };
    let (Sending::Progressive(enough), Ok(query)) = (sending, SealedQuery::decode(bytes)) else {
        return whole();
    };
    let mut asked: Option<Asked> = None;
    for class in query.step_sizes() {
        let Ok(part) = query.first_rows(class, profile) else { return whole() };
        if part.check_sides().is_err() {
            continue;
        }
        let message = part.encode();
        let answer = served.ask(&message, options);
        let trusted = answer.state() == State::Trusted;
        let sd = answer.found.as_ref().map_or(f64::INFINITY, |found| position_sd(&found.covariance));
        let is_enough = enough.is_met(trusted, sd);
        asked = Some(Asked {
            rows: part.len(),
            bytes: message.len() + asked.as_ref().map_or(0, |a| a.bytes),
            before_ms: asked.as_ref().map_or(0.0, |a| a.before_ms + milliseconds(&a.answer)),
            was_trusted: trusted || asked.as_ref().is_some_and(|a| a.was_trusted),
            answer,
        });
        if is_enough {
            break;
        }
    }
    // A device does not send what is lopsided as a whole; an evaluation asks all the same.
    asked.unwrap_or_else(whole)
}

fn milliseconds(answer: &Answer) -> f64 {
    let times = answer.found.as_ref().map(|found| found.times).unwrap_or_default();
    answer.decode_ms + times.retrieve_ms + times.match_ms + times.pose_ms
}
