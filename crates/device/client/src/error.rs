//! Why an image was not sealed, or there is no pose, grouped by what an app does about it.

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use veiloc_obfuscation::SealError;
use veiloc_protocol::{
    ContentAnchorError, MessageId, QueryError, RigMessage, SeparateAnchors, UnbalancedAnchors,
};

use crate::Refusal;

/// Why an image was not sealed, or there is no profile or no pose.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The address of the service cannot be used.
    #[error("{address}: {reason}")]
    Address {
        /// The given address.
        address: String,
        /// What is wrong with it, and the remedy.
        reason: &'static str,
    },
    /// Plain HTTP to another machine.
    #[error("{address}: plain HTTP could be read and changed in transit; use https://")]
    PlainHttp {
        /// The given address.
        address: String,
    },
    /// The token contains invalid characters. The token is not repeated in the message.
    #[error("the token contains characters that are not allowed in a token")]
    Token,
    /// The PEM text contains no usable certificate.
    #[error("no certificate was found; give a PEM file, which begins with -----BEGIN CERTIFICATE-----")]
    Certificates,
    /// Not a valid map name.
    #[error(
        "{name:?} is not a map name; map names have at most 64 characters: letters, digits, `-`, `_` and `.`"
    )]
    MapName {
        /// The given name.
        name: String,
    },
    /// Not a content anchor. Nothing was sent.
    #[error(transparent)]
    Anchor(ContentAnchorError),
    /// Too few rows on one side of the dividing line. The query was not sent, so another image may be taken.
    #[error(transparent)]
    UnbalancedAnchors(#[from] UnbalancedAnchors),
    /// A session without images, or with more than a service accepts. Nothing was sent.
    #[error("a session of {frames} images; it must have 1 to {}", RigMessage::MAX_FRAMES)]
    Frames {
        /// Number of images.
        frames: usize,
    },
    /// Frames of a rig that were not sealed in one session: their lines would give keypoints away (rule L10). Nothing was
    /// sent. Seal all images of a rig in one [`Session`](crate::Session).
    #[error(transparent)]
    SeparateAnchors(#[from] SeparateAnchors),
    /// A progressive query that was not sealed with the given profile. Nothing was sent.
    #[error("{0}; fetch this map's profile, and seal with it another image, taken at least one step away")]
    ProfileMismatch(QueryError),
    /// The service could not be reached, or closed the connection, in every attempt. The same query may be sent again.
    #[error("{server}: {reason}")]
    Network {
        /// Its address.
        server: String,
        /// The message of the system or the transport.
        reason: String,
    },
    /// The service is busy, or the token's quota is used up (408, 429, 503, 504). The same query may be sent again.
    #[error("{refusal}")]
    Busy {
        /// The error response.
        refusal: Refusal,
        /// How long the service asks to wait.
        retry_after: Option<Duration>,
    },
    /// The query is valid, but no pose was found (422).
    #[error("{0}")]
    NotLocalized(Refusal),
    /// The query was sealed with the profile of another map, or of an older version of this one (409 `wrong-profile`).
    /// Fetch the profile; this image must not be sealed a second time.
    #[error("{0}")]
    WrongProfile(Refusal),
    /// The map has another profile or pack than [`ClientOptions::profile_ids`](crate::ClientOptions::profile_ids) or
    /// [`ClientOptions::pack_ids`](crate::ClientOptions::pack_ids) says. It was not used, and nothing was sealed.
    #[error("the {what} of the map {map} is {actual}, not {expected}")]
    OtherId {
        /// `profile` or `pack`.
        what: &'static str,
        /// Name of the map.
        map: String,
        /// The given id.
        expected: MessageId,
        /// The id of the service's.
        actual: MessageId,
    },
    /// Any other error response: about the token, the map or the query.
    #[error("{0}")]
    Refused(Refusal),
    /// The response is not of the expected type. Nothing of it was used.
    #[error("{what} of the service cannot be used: {reason}")]
    BadAnswer {
        /// `the answer` or `the profile`.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// An image could not be sealed.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// The session file cannot be read or written, so no frame of the session may be sent.
    #[error("{}: {source}", path.display())]
    SessionIo {
        /// The file.
        path: PathBuf,
        /// The message of the system.
        source: io::Error,
    },
    /// Another program has the session file open.
    #[error(
        "{}: another program uses this session; close it first, because the frames of a session must be sealed in order",
        path.display()
    )]
    SessionBusy {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a session, or damaged, or of another version.
    #[error("{}: {source}", path.display())]
    SessionBytes {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: SealError,
    },
    /// The session has other options.
    #[error(
        "{}: the session has other options (anchors, band or cells); use its options, or delete the file to begin anew",
        path.display()
    )]
    SessionOptions {
        /// The file.
        path: PathBuf,
    },
}

impl ClientError {
    /// Whether the same query may be sent again later without changes: the query is not the cause.
    pub const fn is_retryable(&self) -> bool {
        matches!(self, Self::Network { .. } | Self::Busy { .. })
    }
}
