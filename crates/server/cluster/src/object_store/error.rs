//! What can be wrong with storage. Every message names the place and says what to do.

use std::path::{Path, PathBuf};

use crate::object_store::refusal::hint_of;
use veiloc_map::regions::{ManifestError, ObjectRef, RegionsError};

/// Why regions were not published or fetched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// What should name storage names none.
    #[error("{url}: {reason}")]
    Address {
        /// What was given.
        url: String,
        /// Why not, and the remedy.
        reason: String,
    },
    /// Storage refused for a reason that stays.
    #[error("{address}: {why} ({said}); {remedy}")]
    Refused {
        /// Of what.
        address: String,
        /// Why.
        why: &'static str,
        /// What to do.
        remedy: &'static str,
        /// What it said.
        said: String,
    },
    /// Storage could not be reached, or said what is not known.
    #[error("{address}: {source}{}", hint_of(address, source))]
    Storage {
        /// Of what.
        address: String,
        /// What it said.
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
    TooLong {
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
        /// What the system said.
        source: std::io::Error,
    },
    /// Regions in a local folder are wrong.
    #[error(transparent)]
    Regions(#[from] RegionsError),
}

/// What to do about what the system said, where it is not plain from that.
fn remedy_of(source: &std::io::Error) -> &'static str {
    match source.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; make room there, or allow a cache less (`--cache-gb`)"
        }
        _ => "",
    }
}

impl StoreError {
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
