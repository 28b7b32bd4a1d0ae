//! Decoding the body of a request and localizing it. The service and the workers of a cluster share this code.

use std::num::NonZeroU64;

use veiloc_localization::{LocalizeError, LocalizeOptions, localize, localize_rig};
use veiloc_map::MapFile;
use veiloc_pose::PoseError;
use veiloc_protocol::{Answer, AnswerTimes, QueryError, RigMessage, SealedFrame, SealedQuery};

/// The kind of body that the client declares by the address it uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyKind {
    /// One sealed query.
    Query,
    /// The sealed queries of a session.
    Rig,
}

/// A decoded body.
#[derive(Debug)]
pub enum DecodedRequest {
    /// One sealed query.
    Query(Box<SealedQuery>),
    /// The sealed queries of a session, 1 to [`RigMessage::MAX_FRAMES`].
    Rig(Vec<SealedFrame>),
}

impl DecodedRequest {
    /// Decodes a body of the given kind.
    ///
    /// # Errors
    /// [`QueryError`]: the body is not of this kind.
    pub fn decode(kind: BodyKind, bytes: &[u8]) -> Result<Self, QueryError> {
        Ok(match kind {
            BodyKind::Query => Self::Query(Box::new(SealedQuery::decode(bytes)?)),
            BodyKind::Rig => Self::Rig(RigMessage::decode(bytes)?.frames),
        })
    }

    /// The kind of this body.
    pub const fn kind(&self) -> BodyKind {
        match self {
            Self::Query(_) => BodyKind::Query,
            Self::Rig(_) => BodyKind::Rig,
        }
    }

    /// The sealed queries, at least one.
    pub fn queries(&self) -> impl ExactSizeIterator<Item = &SealedQuery> {
        let (one, several) = match self {
            Self::Query(query) => (Some(&**query), &[][..]),
            Self::Rig(frames) => (None, frames.as_slice()),
        };
        let all: Vec<&SealedQuery> =
            one.into_iter().chain(several.iter().map(|frame| &frame.query)).collect();
        all.into_iter()
    }

    /// Number of images.
    pub fn frames(&self) -> usize {
        self.queries().len()
    }

    /// Number of rows of all queries.
    pub fn rows(&self) -> usize {
        self.queries().map(SealedQuery::len).sum()
    }

    /// Localizes the queries in `map`. `queue_ms`: time the request waited in the queue, milliseconds.
    ///
    /// # Errors
    /// [`LocalizeFailure`]: the query was sealed for another map, no pose is supported, or the job was stopped.
    pub fn localize(
        &self,
        map: &MapFile,
        options: &LocalizeOptions,
        queue_ms: f64,
    ) -> Result<Answer, LocalizeFailure> {
        match self {
            Self::Query(query) => localize(query, map, options).map(|result| result.answer(map)),
            Self::Rig(frames) => localize_rig(frames, map, options).map(|result| result.answer(map)),
        }
        .map(|answer| Answer { times: AnswerTimes { queue_ms, ..answer.times }, ..answer })
        .map_err(|error| LocalizeFailure::of(&error))
    }
}

/// Why a decoded query got no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LocalizeFailure {
    /// The query was sealed for another map, or with an outdated profile.
    WrongProfile,
    /// The map is empty.
    EmptyMap,
    /// The query supports no pose; the value holds the reason as far as it is known.
    NoPose(NoPose),
    /// The job was cancelled.
    Stopped,
    /// All workers that could localize the query are busy. The client should retry after this many seconds.
    Busy {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// No worker that holds the needed part of the map could be reached. The client should retry after this many
    /// seconds.
    Unreached {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// No worker answered within the time limit.
    TimedOut,
    /// An internal error, which was logged where it happened.
    Broken,
}

/// Why there is no pose, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPose {
    /// No further reason is known.
    Unsupported,
    /// All matching lines run through one anchor.
    OneSided,
    /// Too few rows match the map.
    TooFew,
}

impl LocalizeFailure {
    fn of(error: &LocalizeError) -> Self {
        match error {
            LocalizeError::WrongProfile { .. } => Self::WrongProfile,
            LocalizeError::Frame { source, .. } => Self::of(source),
            LocalizeError::EmptyMap => Self::EmptyMap,
            LocalizeError::Stopped => Self::Stopped,
            LocalizeError::NoPose { source, .. } => Self::NoPose(match source {
                PoseError::OneSided { .. } => NoPose::OneSided,
                PoseError::TooFew { .. } => NoPose::TooFew,
                _ => NoPose::Unsupported,
            }),
        }
    }
}
