//! Errors as exceptions: a type for the program, a message for people.

use std::fmt::Display;

use veiloc_ar::BurstError;
use veiloc_obfuscation::{SealError, SealErrorKind};

/// Why a call failed, by what an app does about it.
#[derive(Debug, thiserror::Error, uniffi::Error)]
#[uniffi(flat_error)]
pub enum VeilocException {
    /// An argument is invalid: an unknown word, a pose that is no rotation.
    #[error("{0}")]
    Argument(String),
    /// The bytes are not a profile of this version: fetch it again, or update the app.
    #[error("{0}")]
    Profile(String),
    /// The frame or its camera cannot be used: sizes, strides, lengths.
    #[error("{0}")]
    Image(String),
    /// Too little texture, or on one side only: take another frame.
    #[error("{0}")]
    Texture(String),
    /// Too few rows on one side of the dividing line: the query must not be sent; take another frame.
    #[error("{0}")]
    Unbalanced(String),
    /// The bytes are not a session: begin a new one.
    #[error("{0}")]
    SessionBytes(String),
    /// The session would have to be placed anew too often: walk on, and show another view.
    #[error("{0}")]
    TooManyStarts(String),
    /// The camera turned away from the session's anchors: turn on or back.
    #[error("{0}")]
    TurnedAway(String),
    /// The frame cannot be sealed as the profile and the options ask.
    #[error("{0}")]
    Seal(String),
    /// The bytes are not an answer of this version.
    #[error("{0}")]
    Answer(String),
    /// The call was cancelled; nothing changed.
    #[error("{0}")]
    Cancelled(String),
    /// The bytes are not a pack of this version, or it has descriptors with which packs are not used: fetch it again, or
    /// update the app.
    #[error("{0}")]
    Pack(String),
    /// Hardly anything in the frame is of the place of the pack: point the camera at the place.
    #[error("{0}")]
    NotThisPlace(String),
}

impl VeilocException {
    pub(crate) fn argument(reason: impl Display) -> Self {
        Self::Argument(reason.to_string())
    }
}

impl From<SealError> for VeilocException {
    fn from(error: SealError) -> Self {
        let text = error.to_string();
        match error.kind() {
            SealErrorKind::Image => Self::Image(text),
            SealErrorKind::Texture => Self::Texture(text),
            SealErrorKind::Unbalanced => Self::Unbalanced(text),
            SealErrorKind::NotThisPlace => Self::NotThisPlace(text),
            SealErrorKind::Session => Self::SessionBytes(text),
            SealErrorKind::TooManyStarts => Self::TooManyStarts(text),
            SealErrorKind::TurnedAway => Self::TurnedAway(text),
            SealErrorKind::Stopped => Self::Cancelled(text),
            _ => Self::Seal(text),
        }
    }
}

impl From<BurstError> for VeilocException {
    fn from(error: BurstError) -> Self {
        match error {
            BurstError::Frame(error) => error.into(),
            error => Self::argument(error),
        }
    }
}
