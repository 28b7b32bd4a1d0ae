//! What a body holds, and localizing it: the same wherever the map is.

use std::num::NonZeroU64;

use veiloc_localization::{LocalizeError, LocalizeOptions, StageTimes, localize, localize_rig};
use veiloc_map::MapFile;
use veiloc_pose::PoseError;
use veiloc_protocol::{Answer, QueryError, RigMessage, SealedFrame, SealedQuery};

use crate::answer::{answer_of, answer_of_rig};

/// What a body is said to hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One sealed query.
    Query,
    /// Those of a session.
    Rig,
}

/// What a body was found to hold.
#[derive(Debug)]
pub enum Asked {
    /// One sealed query.
    Query(Box<SealedQuery>),
    /// Those of a session, 1 to [`RigMessage::MOST_FRAMES`].
    Rig(Vec<SealedFrame>),
}

impl Asked {
    /// Reads a body.
    ///
    /// # Errors
    /// [`QueryError`]: it does not hold what it is said to.
    pub fn decode(kind: Kind, bytes: &[u8]) -> Result<Self, QueryError> {
        Ok(match kind {
            Kind::Query => Self::Query(Box::new(SealedQuery::decode(bytes)?)),
            Kind::Rig => Self::Rig(RigMessage::decode(bytes)?.frames),
        })
    }

    /// What it is.
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Query(_) => Kind::Query,
            Self::Rig(_) => Kind::Rig,
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

    /// Images that it is about.
    pub fn frames(&self) -> usize {
        self.queries().len()
    }

    /// Rows of all queries.
    pub fn rows(&self) -> usize {
        self.queries().map(|query| query.descriptors().len()).sum()
    }

    /// Localizes it after a wait of so many milliseconds.
    ///
    /// # Errors
    /// [`Unanswered`]: sealed for another map, no pose, or it was stopped.
    pub fn localize(
        &self,
        map: &MapFile,
        options: &LocalizeOptions,
        queue_ms: f64,
    ) -> Result<Found, Unanswered> {
        match self {
            Self::Query(query) => localize(query, map, options)
                .map(|found| Found { answer: answer_of(&found, queue_ms), times: found.times }),
            Self::Rig(frames) => localize_rig(frames, map, options)
                .map(|found| Found { answer: answer_of_rig(&found, queue_ms), times: found.times }),
        }
        .map_err(|error| Unanswered::of(&error))
    }
}

/// What is told, and what the stages took.
#[derive(Debug, Clone)]
pub struct Found {
    /// What is told.
    pub answer: Answer,
    /// What the stages took.
    pub times: StageTimes,
}

/// Why a query that was read got no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unanswered {
    /// It was sealed for another map, or with the profile of an older one.
    WrongProfile,
    /// The map holds nothing.
    EmptyMap,
    /// No pose is supported by it, and what is known of why.
    NoPose(NoPose),
    /// It was given up.
    Stopped,
    /// Those who could localize it have no room; after so many seconds they should.
    Busy {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// Nobody who holds this part of the map could be reached; after so many seconds somebody may.
    Unreached {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// Nobody answered in time.
    TimedOut,
    /// A bug of ours, which was logged where it happened.
    Broken,
}

/// What is known of why there is no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPose {
    /// Nothing more.
    Unsupported,
    /// All lines that match run through one anchor.
    OneSided,
    /// Too few rows match the map.
    TooFew,
}

impl Unanswered {
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
