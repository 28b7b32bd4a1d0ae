//! Why a message did not get there, with the remedy.

use std::time::Duration;

use crate::bus::subject::{BadWord, Subject};

/// Why a request got no reply, or a bus could not be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BusError {
    /// A word that cannot be a part of a subject.
    #[error(transparent)]
    Subject(#[from] BadWord),
    /// Nobody is in the group.
    #[error("nobody has joined {subject}; start a worker that does")]
    Nobody {
        /// Of which subject.
        subject: Subject,
    },
    /// No reply in time.
    #[error("no reply on {subject} within {} ms", within.as_millis())]
    TimedOut {
        /// On which subject.
        subject: Subject,
        /// How long was waited.
        within: Duration,
    },
    /// A message that is longer than any may be.
    #[error(
        "a message of {bytes} bytes is longer than the bus takes ({longest}); raise `max_payload` of its servers"
    )]
    TooLong {
        /// How long it is.
        bytes: usize,
        /// How long it may be.
        longest: usize,
    },
    /// Servers that take only short messages.
    #[error(
        "the NATS server takes messages of {longest} bytes, and queries need {needed}; set `max_payload: {needed}` (or \
         more) in the settings of all its servers"
    )]
    SmallPayload {
        /// What it takes.
        longest: usize,
        /// What is needed.
        needed: usize,
    },
    /// No server.
    #[error(
        "no NATS server at {servers}: {reason}; check the addresses, and with TLS the authority (--nats-ca)"
    )]
    Connect {
        /// Their addresses, without passwords.
        servers: String,
        /// What was said.
        reason: String,
    },
    /// An address that is none.
    #[error("{address:?} is no address of a NATS server; write nats://HOST:PORT or tls://HOST:PORT")]
    Address {
        /// The text, without a password.
        address: String,
    },
    /// A user or a password in an address that cannot be used.
    #[error(
        "an address of a NATS server names a user and a password, and {reason}; choose others, or give a file of credentials"
    )]
    Login {
        /// What is wrong with them.
        reason: &'static str,
    },
    /// A file of credentials that cannot be used.
    #[error("{path}: {reason}; give a file of credentials as `nsc` writes it")]
    Credentials {
        /// Which file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// The connection ended and does not come back.
    #[error("the connection to the bus is closed")]
    Closed,
}
