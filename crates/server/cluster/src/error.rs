//! What can go wrong between the machines of a cluster: bus, object store, frames, settings. Every message names the remedy.

use std::path::{Path, PathBuf};
use std::time::Duration;

use veiloc_map::regions::ObjectRef;
use veiloc_map::{ManifestError, MapError};
use veiloc_service::ServerError;

use crate::bus::{BadWord, Subject};
use crate::object_store::refusal::hint_of;

/// Why a worker or a gateway could not start, a request got no reply, or a map was not published or fetched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// There is no such map.
    #[error("no map {map:?} is published at {place}; publish one with `veiloc map publish`")]
    NoMap {
        /// Its name.
        map: String,
        /// Where it was looked for.
        place: String,
    },
    /// A region or an index.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A share of the regions that is none.
    #[error(
        "{text:?} is no share of regions; write 1/3 for the first of three, or numbers with commas between: 0,4,7"
    )]
    Share {
        /// What was written.
        text: String,
    },
    /// A name that no map has.
    #[error("{name:?} cannot name a map; use letters, digits, `-`, `_` and `.`, at most 64")]
    Name {
        /// The name.
        name: String,
    },
    /// A profile that is none.
    #[error("the profile {object} that the manifest names: {source}; publish the map again")]
    Profile {
        /// Which object.
        object: veiloc_map::regions::ObjectId,
        /// What is wrong with it.
        source: veiloc_protocol::QueryError,
    },
    /// The listener of probes and metrics.
    #[error(transparent)]
    Probes(#[from] ServerError),
    /// Threads or signal handlers could not be had.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was asked for.
        what: &'static str,
        /// What it reported.
        source: std::io::Error,
    },

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
    MessageTooLong {
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
        /// What was reported.
        reason: String,
    },
    /// An address that is none.
    #[error("{address:?} is no address of a NATS server; write nats://HOST:PORT or tls://HOST:PORT")]
    BusAddress {
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
    BusClosed,
    /// What should name storage names none.
    #[error("{url}: {reason}")]
    StorageAddress {
        /// What was given.
        url: String,
        /// Why not, and the remedy.
        reason: String,
    },
    /// Storage refused for a reason that stays.
    #[error("{address}: {why} ({reported}); {remedy}")]
    StorageRefused {
        /// Of what.
        address: String,
        /// Why.
        why: &'static str,
        /// What to do.
        remedy: &'static str,
        /// What it reported.
        reported: String,
    },
    /// Storage could not be reached, or reported an unknown error.
    #[error("{address}: {source}{}", hint_of(address, source))]
    Storage {
        /// Of what.
        address: String,
        /// What it reported.
        source: Box<object_store::Error>,
    },
    /// There is no such thing in storage.
    #[error("{address}: not there; {remedy}")]
    NotThere {
        /// Of what.
        address: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Nothing came for so long.
    #[error("{address}: nothing came for {seconds} s; look whether the storage answers, and try again")]
    Stalled {
        /// Of what.
        address: String,
        /// How long.
        seconds: u64,
    },
    /// There is more than there may be.
    #[error("{address}: more than {most} bytes, where no more may be; this is not what veiloc published")]
    ObjectTooLong {
        /// Of what.
        address: String,
        /// Most bytes.
        most: u64,
    },
    /// A pointer is not what it should be.
    #[error("{address}: {reason}; publish the map again with `veiloc map publish`")]
    Pointer {
        /// Of what.
        address: String,
        /// What is wrong.
        reason: String,
    },
    /// A manifest is not what it should be.
    #[error("{address}: {source}")]
    Manifest {
        /// Of what.
        address: String,
        /// What is wrong.
        source: ManifestError,
    },
    /// An object is not what its name says.
    #[error(
        "{address}: {found}, where the object {} of {} bytes should be; publish the map again with `veiloc map publish`",
        expected.sha256,
        expected.bytes
    )]
    Object {
        /// Of what.
        address: String,
        /// What should be there.
        expected: ObjectRef,
        /// What is there.
        found: String,
    },
    /// What is needed is larger than the cache may be.
    #[error("{}: {needed} bytes are needed, and the cache may hold {most}; allow it more, or take fewer regions", path.display())]
    CacheTooSmall {
        /// The cache.
        path: PathBuf,
        /// Bytes that are needed together.
        needed: u64,
        /// Bytes that it may hold.
        most: u64,
    },
    /// A local file could not be read or written.
    #[error("{}: {source}{}", path.display(), remedy_of(source))]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system reported.
        source: std::io::Error,
    },
    /// No protobuf, or of other fields.
    #[error("not a frame of this cluster")]
    Frame,
    /// Written by a newer program.
    #[error(
        "a frame of version {found}, this program reads {}; use one version of veiloc in a cluster",
        crate::message::VERSION
    )]
    FrameVersion {
        /// Its version.
        found: u32,
    },
    /// A field that is not what it may be.
    #[error("the field {field} of a frame is not what it may be")]
    FrameField {
        /// Which.
        field: &'static str,
    },
    /// An answer to another question.
    #[error("a reply to another request")]
    OtherRequest,
}

/// What to do about a system error whose message does not say it.
fn remedy_of(source: &std::io::Error) -> &'static str {
    match source.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; make room there, or allow a cache less (`--cache-gb`)"
        }
        _ => "",
    }
}

impl ClusterError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }

    /// Whether the same may go well a little later: storage cannot be reached, or says so of itself.
    pub fn may_pass(&self) -> bool {
        use object_store::Error as Cause;
        match self {
            Self::Stalled { .. } | Self::Object { .. } => true,
            Self::Storage { source, .. } => {
                matches!(**source, Cause::Generic { .. } | Cause::JoinError { .. })
            }
            _ => false,
        }
    }
}
