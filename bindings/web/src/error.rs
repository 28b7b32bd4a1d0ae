//! What can go wrong, with a name for programs.

use veiloc_attacks::AttackError;
use veiloc_features::FeatureError;
use veiloc_obfuscation::{SealError, SessionAnchorsError};
use veiloc_protocol::{Lopsided, QueryError};

/// Why a call gives nothing.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The message is not one that the loader of this version writes.
    #[error("the call cannot be read: {reason}; load loader and WebAssembly of one version")]
    Request {
        /// What is wrong.
        reason: String,
    },
    /// A handle that nothing is kept under.
    #[error("no {what} is kept under {handle}; it was given back, or the worker was started anew")]
    Gone {
        /// `profile`, `session` or `query`.
        what: &'static str,
        /// The number.
        handle: u32,
    },
    /// Bytes that are no profile.
    #[error("these bytes are no profile: {0}")]
    Profile(QueryError),
    /// A camera that no image has.
    #[error("camera {text:?}: {reason}")]
    Camera {
        /// What was given.
        text: String,
        /// What is wrong.
        reason: String,
    },
    /// An option that is no option.
    #[error("option {name}: {reason}")]
    Option {
        /// Its name.
        name: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The image cannot be extracted from or sealed, or bytes are no session.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// A query that could not fix a pose.
    #[error(transparent)]
    Lopsided(#[from] Lopsided),
    /// A query that does not belong to the profile.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// Anchors that cannot be tied so.
    #[error(transparent)]
    Anchors(#[from] SessionAnchorsError),
    /// An attack that cannot run.
    #[error(transparent)]
    Attack(#[from] AttackError),
}

impl WebError {
    /// For programs: what `VeilocError.kind` is in the npm package.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Request { .. } => "call",
            Self::Gone { .. } => "gone",
            Self::Profile(_) => "profile",
            Self::Camera { .. } => "camera",
            Self::Option { .. } | Self::Anchors(_) => "option",
            Self::Seal(SealError::Image(_)) => "image",
            Self::Seal(
                SealError::NotASession | SealError::SessionVersion { .. } | SealError::SessionDamaged { .. },
            ) => "session",
            Self::Seal(SealError::TooManyStarts { .. }) => "too-many-starts",
            Self::Seal(SealError::TurnedAway { .. }) => "turned-away",
            Self::Seal(_) => "seal",
            Self::Lopsided(_) => "lopsided",
            Self::Query(_) => "query",
            Self::Attack(_) => "attack",
        }
    }
}

impl From<FeatureError> for WebError {
    fn from(error: FeatureError) -> Self {
        Self::Seal(error.into())
    }
}
