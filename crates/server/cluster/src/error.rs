//! Errors of a cluster: bus, object store, frames, settings. Every message names the remedy.

use std::path::{Path, PathBuf};
use std::time::Duration;

use veiloc_map::regions::ObjectRef;
use veiloc_map::{ManifestError, MapError};
use veiloc_service::ServerError;

use crate::bus::{InvalidSubjectWord, Subject};
use crate::object_store::refusal::hint_of;

/// Why a worker or a gateway could not start, a request got no reply, or a map was not published or fetched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// The map is not published.
    #[error("no map {map:?} is published at {place}; publish one with `veiloc map publish`")]
    NoMap {
        /// Its name.
        map: String,
        /// Where it was searched.
        place: String,
    },
    /// A region or an index cannot be used.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Invalid share of regions.
    #[error(
        "{text:?} is not a share of regions; write 1/3 for the first of three, or numbers separated by commas: 0,4,7"
    )]
    Share {
        /// The given text.
        text: String,
    },
    /// Invalid map name.
    #[error("{name:?} cannot name a map; use letters, digits, `-`, `_` and `.`, at most 64")]
    Name {
        /// The name.
        name: String,
    },
    /// Invalid profile.
    #[error("the profile {object} that the manifest names: {source}; publish the map again")]
    Profile {
        /// The object.
        object: veiloc_map::regions::ObjectId,
        /// What is wrong with it.
        source: veiloc_protocol::QueryError,
    },
    /// The listener of probes and metrics failed.
    #[error(transparent)]
    Probes(#[from] ServerError),
    /// The system refused threads or signal handlers.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was requested.
        what: &'static str,
        /// The reported error.
        source: std::io::Error,
    },

    /// Invalid subject.
    #[error(transparent)]
    Subject(#[from] InvalidSubjectWord),
    /// The group is empty.
    #[error("no worker has joined {subject}; start a worker for it")]
    NoResponders {
        /// The subject.
        subject: Subject,
    },
    /// No reply in time.
    #[error("no reply on {subject} within {} ms", within.as_millis())]
    TimedOut {
        /// The subject.
        subject: Subject,
        /// The time limit.
        within: Duration,
    },
    /// The message is too long.
    #[error(
        "a message of {bytes} bytes is longer than the bus takes ({longest}); raise `max_payload` of its servers"
    )]
    MessageTooLong {
        /// Its length, bytes.
        bytes: usize,
        /// The limit, bytes.
        longest: usize,
    },
    /// The message limit of the server is too small.
    #[error(
        "the NATS server takes messages of {longest} bytes, and queries need {needed}; set `max_payload: {needed}` (or \
         more) in the settings of all its servers"
    )]
    SmallPayload {
        /// The limit of the server, bytes.
        longest: usize,
        /// The needed length, bytes.
        needed: usize,
    },
    /// No server can be reached.
    #[error(
        "no NATS server at {servers}: {reason}; check the addresses, and with TLS the authority (--nats-ca)"
    )]
    Connect {
        /// Their addresses, without passwords.
        servers: String,
        /// The reported error.
        reason: String,
    },
    /// Invalid address.
    #[error("{address:?} is not an address of a NATS server; write nats://HOST:PORT or tls://HOST:PORT")]
    BusAddress {
        /// The text, without a password.
        address: String,
    },
    /// User or password in an address cannot be used.
    #[error(
        "login in the address of a NATS server: {reason}; choose another login, or give a file of credentials"
    )]
    Login {
        /// What is wrong with them.
        reason: &'static str,
    },
    /// The credentials file cannot be used.
    #[error("{path}: {reason}; give a file of credentials as `nsc` writes it")]
    Credentials {
        /// Which file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// The connection is closed for good.
    #[error("the connection to the bus is closed")]
    BusClosed,
    /// The URL names no usable storage.
    #[error("{url}: {reason}")]
    StorageAddress {
        /// The given URL.
        url: String,
        /// The reason, and the remedy.
        reason: String,
    },
    /// Storage refused the request; retrying does not help.
    #[error("{address}: {why} ({reported}); {remedy}")]
    StorageRefused {
        /// Address of the object.
        address: String,
        /// Why.
        why: &'static str,
        /// The remedy.
        remedy: &'static str,
        /// The reported error.
        reported: String,
    },
    /// Storage could not be reached, or reported an unknown error.
    #[error("{address}: {source}{}", hint_of(address, source))]
    Storage {
        /// Address of the object.
        address: String,
        /// The reported error.
        source: Box<object_store::Error>,
    },
    /// The object is not in storage.
    #[error("{address}: not there; {remedy}")]
    NotThere {
        /// Address of the object.
        address: String,
        /// The remedy.
        remedy: &'static str,
    },
    /// Storage sent nothing for this long.
    #[error("{address}: no data for {seconds} s; check that the storage answers, and try again")]
    Stalled {
        /// Address of the object.
        address: String,
        /// How long.
        seconds: u64,
    },
    /// The object is longer than allowed.
    #[error("{address}: longer than the {most} bytes allowed there; this was not published by veiloc")]
    ObjectTooLong {
        /// Address of the object.
        address: String,
        /// Most bytes.
        most: u64,
    },
    /// Invalid pointer.
    #[error("{address}: {reason}; publish the map again with `veiloc map publish`")]
    Pointer {
        /// Address of the object.
        address: String,
        /// What is wrong.
        reason: String,
    },
    /// Invalid manifest.
    #[error("{address}: {source}")]
    Manifest {
        /// Address of the object.
        address: String,
        /// What is wrong.
        source: ManifestError,
    },
    /// The content of an object does not match its name.
    #[error(
        "{address}: found {found} instead of the object {} of {} bytes; publish the map again with `veiloc map publish`",
        expected.sha256,
        expected.bytes
    )]
    Object {
        /// Address of the object.
        address: String,
        /// The expected object.
        expected: ObjectRef,
        /// The content that was found.
        found: String,
    },
    /// The cache limit is smaller than the needed objects.
    #[error("{}: {needed} bytes are needed, but the cache is limited to {most}; raise the limit, or hold fewer regions", path.display())]
    CacheTooSmall {
        /// The cache.
        path: PathBuf,
        /// Bytes needed together.
        needed: u64,
        /// The limit, bytes.
        most: u64,
    },
    /// A local file could not be read or written.
    #[error("{}: {source}{}", path.display(), remedy_of(source))]
    Io {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The bytes are not a valid frame.
    #[error("not a frame of this cluster")]
    Frame,
    /// The frame has an unknown version.
    #[error(
        "a frame of version {found}, this program reads {}; update the other machine, or this one",
        crate::frame_version::FrameVersions::OWN
    )]
    FrameVersion {
        /// Its version.
        found: u32,
    },
    /// A field has an invalid value.
    #[error("the field {field} of a frame is invalid")]
    FrameField {
        /// The field.
        field: &'static str,
    },
    /// The reply belongs to another request.
    #[error("a reply to another request")]
    OtherRequest,
}

/// Remedy for a system error whose message has none.
fn remedy_of(source: &std::io::Error) -> &'static str {
    match source.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; free disk space there, or lower the limit of the cache (`--cache-gb`)"
        }
        _ => "",
    }
}

impl ClusterError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }

    /// Whether a retry may succeed: storage was unreachable or reported a temporary error.
    pub fn is_transient(&self) -> bool {
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
