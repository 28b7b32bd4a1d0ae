//! Errors, each with a name for programs.

use veiloc_attacks::AttackError;
use veiloc_features::FeatureError;
use veiloc_obfuscation::{SealError, SessionAnchorsError};
use veiloc_protocol::QueryError;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The message does not have the form that the loader of this version writes.
    #[error("the call cannot be read: {reason}; load veiloc.wasm and the loader of the same version")]
    Request {
        /// What is wrong.
        reason: String,
    },
    /// The handle is unknown.
    #[error("there is no {what} with handle {handle}; it was freed or used up, or the worker was restarted")]
    UnknownHandle {
        /// `profile`, `sealer`, `session`, `segmenter`, `image` or `query`.
        what: &'static str,
        /// The number.
        handle: u32,
    },
    /// The bytes are not a profile.
    #[error("these bytes are not a profile: {0}")]
    Profile(QueryError),
    /// The bytes are not a pack.
    #[error("these bytes are not a pack: {0}")]
    Pack(QueryError),
    /// The camera is invalid.
    #[error("camera {text:?}: {reason}")]
    Camera {
        /// The camera as given.
        text: String,
        /// What is wrong.
        reason: String,
    },
    /// An option is invalid.
    #[error("option {name}: {reason}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The image cannot be used or sealed, or the bytes are not a session.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// The query does not belong to the profile.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// The frame of the anchors is unknown.
    #[error(transparent)]
    Anchors(#[from] SessionAnchorsError),
    /// A pose of an AR world is none.
    #[error("the pose has a rotation of zero, or a number that is not finite")]
    Pose,
    /// The attack cannot run.
    #[error(transparent)]
    Attack(#[from] AttackError),
}

impl WebError {
    /// Name for programs: `VeilocError.kind` of the npm package.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Request { .. } => "call",
            Self::UnknownHandle { .. } => "gone",
            Self::Profile(_) => "profile",
            Self::Pack(_) => "pack",
            Self::Camera { .. } => "camera",
            Self::Option { .. } | Self::Anchors(_) => "option",
            Self::Seal(error) => error.kind().name(),
            Self::Query(_) => "query",
            Self::Pose => "pose",
            Self::Attack(_) => "attack",
        }
    }
}

impl From<FeatureError> for WebError {
    fn from(error: FeatureError) -> Self {
        Self::Seal(error.into())
    }
}
