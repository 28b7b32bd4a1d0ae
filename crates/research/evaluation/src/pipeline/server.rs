//! The server: decoding and localization of a sent query.

use std::time::Instant;

use veiloc_localization::{Localization, LocalizeError, LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_pose::{PoseError, State};
use veiloc_protocol::{QueryError, SealedQuery};

/// Why there is no pose.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LocalizeFailure {
    /// The bytes are not a query.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// The query was not localized.
    #[error(transparent)]
    Localize(#[from] LocalizeError),
}

/// The result for one query.
pub(crate) struct LocalizeResult {
    /// The pose, or why there is none.
    pub(crate) found: Result<Localization, LocalizeFailure>,
    /// Milliseconds to decode the query.
    pub(crate) decode_ms: f64,
}

impl LocalizeResult {
    /// State of the pose.
    pub(crate) fn state(&self) -> State {
        self.found.as_ref().map_or(State::NotFound, |found| found.state)
    }

    /// Natural logarithm of the evidence against chance, also for a pose that was rejected as no better than chance;
    /// `None` without a pose.
    pub(crate) fn log_evidence(&self) -> Option<f64> {
        match &self.found {
            Ok(found) => Some(found.confidence.log_evidence),
            Err(LocalizeFailure::Localize(LocalizeError::NoPose {
                source: PoseError::Chance { log_evidence },
                ..
            })) => Some(*log_evidence),
            Err(_) => None,
        }
    }
}

/// Decodes the sent bytes and localizes the query.
pub(crate) fn decode_and_localize(map: &MapFile, bytes: &[u8], options: &LocalizeOptions) -> LocalizeResult {
    let started = Instant::now();
    let decoded = SealedQuery::decode(bytes);
    let decode_ms = started.elapsed().as_secs_f64() * 1e3;
    let found = match decoded {
        Ok(query) => localize(&query, map, options).map_err(LocalizeFailure::from),
        Err(error) => Err(error.into()),
    };
    LocalizeResult { found, decode_ms }
}
