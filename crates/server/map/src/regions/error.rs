//! What can be wrong with regions. Every message names the file and says what to do.

use std::path::{Path, PathBuf};

use crate::MapError;

use crate::regions::object::ObjectRef;

/// Why a map was not cut, or regions not read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegionsError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A map, or a region as a map, is not what it should be.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A map cannot be cut so.
    #[error("the map cannot be cut: {reason}")]
    Cut {
        /// Why, and the remedy.
        reason: String,
    },
    /// A map cannot have this name.
    #[error("{name:?} is no name of a map: take 1 to 64 of letters, digits, `-`, `_` and `.`")]
    Name {
        /// The name.
        name: String,
    },
    /// There are no regions in the folder.
    #[error("{}: no regions here: `veiloc map split MAP --out DIR` makes such a folder", path.display())]
    NoRegions {
        /// The manifest that is not there.
        path: PathBuf,
    },
    /// A manifest is not what it should be.
    #[error("{from}: {source}")]
    Manifest {
        /// The file or address it was read from.
        from: String,
        /// What is wrong.
        source: ManifestError,
    },
    /// An index is not what it should be.
    #[error("{}: {reason}; cut the map again with `veiloc map split`", path.display())]
    Index {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// An index was written by a newer program.
    #[error(
        "{}: index version {found}, but this program reads version {supported}; publish the map again with this program, or \
         use the one that published it",
        path.display()
    )]
    IndexVersion {
        /// Which file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The one this program reads.
        supported: u32,
    },
    /// A file does not hold what its name says.
    #[error(
        "{}: {found}, where the object {} of {} bytes should be; it is damaged: fetch it again, or cut the map again",
        path.display(),
        expected.sha256,
        expected.bytes
    )]
    Object {
        /// Which file.
        path: PathBuf,
        /// What should be there.
        expected: ObjectRef,
        /// What is there.
        found: String,
    },
    /// An object is sound, and not what the manifest says of it.
    #[error("{}: {reason}: the manifest was put together wrongly; cut the map again", path.display())]
    Mismatch {
        /// Which file.
        path: PathBuf,
        /// What does not fit.
        reason: String,
    },
}

impl RegionsError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }
}

/// What is wrong with the bytes of a manifest.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// More bytes than any manifest has.
    #[error("a manifest of more than {most} bytes; nothing veiloc writes is so long")]
    TooLong {
        /// Most bytes.
        most: usize,
    },
    /// No JSON, or not of a manifest.
    #[error("not a manifest of regions: {0}; `veiloc map split` makes one")]
    Json(#[from] serde_json::Error),
    /// Of a version that this program does not know.
    #[error(
        "manifest version {found}, but this program reads version {supported}; publish the map again with this program, or \
         use the one that published it"
    )]
    Version {
        /// Its version.
        found: u32,
        /// The one this program reads.
        supported: u32,
    },
    /// Right by form, and yet impossible.
    #[error("an impossible manifest: {reason}; cut the map again with `veiloc map split`")]
    Impossible {
        /// What is wrong.
        reason: String,
    },
    /// The same content written in another way: one content would have two ids.
    #[error(
        "not written as veiloc writes a manifest, so that its id is no name of its content; cut the map again"
    )]
    SecondForm,
    /// It is of another map.
    #[error(
        "the manifest of the map {found:?}, where one of {expected:?} was asked for; publish the map again"
    )]
    OtherMap {
        /// Name of the map that was asked for.
        expected: String,
        /// Name of the map that it is of.
        found: String,
    },
    /// The bytes are of another manifest than was asked for.
    #[error("the manifest {found}, where {expected} was asked for; fetch it again")]
    OtherId {
        /// The id that was asked for.
        expected: crate::regions::ObjectId,
        /// The id of what is there.
        found: crate::regions::ObjectId,
    },
}
