//! Why an image was not sealed, or there is no pose, by what an app does about it.

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use veiloc_obfuscation::SealError;
use veiloc_protocol::{Lopsided, QueryError, RigMessage};

use crate::Refusal;

/// Why an image was not sealed, or there is no profile or no pose.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The address of the service cannot be used.
    #[error("{address}: {reason}")]
    Address {
        /// What was given.
        address: String,
        /// What is wrong with it, and the remedy.
        reason: &'static str,
    },
    /// Plain HTTP beyond this machine.
    #[error("{address}: plain HTTP could be read and changed on the way")]
    PlainHttp {
        /// What was given.
        address: String,
    },
    /// The token holds characters that no token has. It is not repeated.
    #[error("the token holds characters that no token has")]
    Token,
    /// Nothing in the certificates can be used.
    #[error(
        "there is no certificate in what was given; PEM is needed, which begins with -----BEGIN CERTIFICATE-----"
    )]
    Certificates,
    /// A name that no map has.
    #[error("{name:?} names no map; names of maps are letters, digits, `-`, `_` and `.`, at most 64")]
    MapName {
        /// What was given.
        name: String,
    },
    /// Too few rows on one side of the dividing line: not sent, so another image may be taken.
    #[error(transparent)]
    Lopsided(#[from] Lopsided),
    /// A session of no image, or of more than a service takes: not sent.
    #[error("a session of {frames} images; it has 1 to {}", RigMessage::MOST_FRAMES)]
    Frames {
        /// How many there were.
        frames: usize,
    },
    /// A progressive query that was not sealed with the profile that was given: not sent.
    #[error("{0}")]
    NotOfProfile(QueryError),
    /// The service was not reached, or broke off, as often as it was tried. The same query may be sent again.
    #[error("{server}: {reason}")]
    Network {
        /// Its address.
        server: String,
        /// What the system or the transport said.
        reason: String,
    },
    /// The service is busy, or the token's allowance is used (408, 429, 503, 504). The same query may be sent again.
    #[error("{refusal}")]
    Busy {
        /// What it said.
        refusal: Refusal,
        /// How long it asks to wait.
        retry_after: Option<Duration>,
    },
    /// The query is good, but no pose is supported by it (422).
    #[error("{0}")]
    NotLocalized(Refusal),
    /// The query was sealed with the profile of another map, or of an older state of this one (409 `wrong-profile`).
    /// Fetch the profile; this image must not be sealed a second time.
    #[error("{0}")]
    WrongProfile(Refusal),
    /// Any other refusal: of the token, the map, the query.
    #[error("{0}")]
    Refused(Refusal),
    /// What the service answered is not what was asked for. Nothing of it was used.
    #[error("{what} of the service cannot be used: {reason}")]
    BadAnswer {
        /// `the answer` or `the profile`.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// Nothing could be extracted from an image.
    #[error(transparent)]
    Extract(#[from] SealError),
    /// What was extracted from an image could not be sealed.
    #[error("{}: {source}", path.display())]
    Seal {
        /// The image.
        path: PathBuf,
        /// What is wrong.
        source: SealError,
    },
    /// The file of a session cannot be read or written, so no frame of it may be sent.
    #[error("{}: {source}", path.display())]
    SessionIo {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another program has the file of the session open.
    #[error("{}: another program seals with this session; its frames must know of each other", path.display())]
    SessionBusy {
        /// The file.
        path: PathBuf,
    },
    /// The file is no session, or damaged, or of another version.
    #[error("{}: {source}", path.display())]
    SessionBytes {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: SealError,
    },
    /// The session was begun with other options.
    #[error("{}: the session was begun with other options (anchors, band or cells)", path.display())]
    SessionOptions {
        /// The file.
        path: PathBuf,
    },
}

impl ClientError {
    /// Whether the same query may be sent again later, as it is: nothing was wrong with it.
    pub const fn may_send_again(&self) -> bool {
        matches!(self, Self::Network { .. } | Self::Busy { .. })
    }
}
