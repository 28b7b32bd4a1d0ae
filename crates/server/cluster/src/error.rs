//! Errors of the object store, of workers and of gateways. Every message names the remedy.

use std::path::{Path, PathBuf};

use veiloc_map::regions::ObjectRef;
use veiloc_map::{ManifestError, MapError};
use veiloc_service::ServerError;

use crate::object_store::refusal::hint_of;

/// Why a worker or a gateway could not start, or a map was not published or fetched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// A region or an index cannot be used.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Invalid profile.
    #[error("the profile {object} that the manifest names: {source}; publish the map again")]
    Profile {
        /// The object.
        object: veiloc_map::regions::ObjectId,
        /// What is wrong with it.
        source: veiloc_protocol::QueryError,
    },
    /// The service failed.
    #[error(transparent)]
    Service(#[from] ServerError),
    /// The system refused threads.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was requested.
        what: &'static str,
        /// The reported error.
        source: std::io::Error,
    },
    /// Workers cannot be asked with these settings.
    #[error("{setting}: {reason}")]
    Workers {
        /// The option, and its value if it is no secret.
        setting: String,
        /// The reason, and the remedy.
        reason: String,
    },
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
    /// Nothing is in storage at all.
    #[error("{address}: nothing is there; is the drive mounted, and the address right?")]
    StorageEmpty {
        /// Address of the storage.
        address: String,
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
    #[error("{}: {needed} bytes are needed, but the cache is limited to {most}; raise the limit (`--cache-gb`)", path.display())]
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
