//! What can be wrong with a map, a map file, its regions or a COLMAP model. Every message names the file and says what to do.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::regions::{ObjectId, ObjectRef};

/// Why a map or a model was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The folder does not hold a COLMAP model.
    #[error(
        "{}: no COLMAP model here: {wanted} are not all present, neither as .txt nor as .bin; give the folder that \
         holds them",
        dir.display()
    )]
    NoColmapModel {
        /// The folder.
        dir: PathBuf,
        /// Which files it must hold.
        wanted: &'static str,
    },
    /// A model is to be written as text into a folder that holds a binary one.
    #[error(
        "{}: a binary COLMAP model is there, and would be read in the place of the text; remove its .bin files, or give \
         another folder",
        dir.display()
    )]
    BinaryModelThere {
        /// The folder.
        dir: PathBuf,
    },
    /// A record of a COLMAP file is not what it should be.
    #[error("{}, {place}: {reason}", path.display())]
    Colmap {
        /// Which file.
        path: PathBuf,
        /// Where in it.
        place: Place,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Records of a COLMAP model do not fit together.
    #[error("COLMAP model{}: {record} {reason}", in_dir(dir.as_deref()))]
    ColmapRecord {
        /// The folder it was read from, when it was read from one.
        dir: Option<PathBuf>,
        /// Which record.
        record: Record,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Posed images do not fit together.
    #[error("the posed images do not fit together: {record} {reason}")]
    PosedImages {
        /// Which image or point.
        record: Record,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// A setting is out of its range.
    #[error("setting {setting} is {value}; allowed is {allowed}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The file is not a map.
    #[error("{}: not a veiloc map; maps are made by `veiloc map build` or `veiloc map import`", path.display())]
    NotAMap {
        /// Which file.
        path: PathBuf,
    },
    /// The file is a map of another version of the format.
    #[error(
        "{}: map format version {found}, but this program reads version {supported}; build the map again with this \
         program, or use the one that wrote it",
        path.display()
    )]
    Version {
        /// Which file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version this program reads.
        supported: u32,
    },
    /// The file has a part that this program does not know.
    #[error("{}: section {code} of the map is unknown: it was written by a newer version; use a newer veiloc", path.display())]
    UnknownSection {
        /// Which file.
        path: PathBuf,
        /// The section's number.
        code: u32,
    },
    /// The file ends before it should, or goes on after it should end.
    #[error(
        "{}: the map is {actual} bytes long, {expected} were written; it was cut short or appended to: copy it again \
         or build it again",
        path.display()
    )]
    Length {
        /// Which file.
        path: PathBuf,
        /// Its length, bytes.
        actual: u64,
        /// The length its header tells, or the least a map can have.
        expected: u64,
    },
    /// Bytes changed since the map was written.
    #[error(
        "{}: the checksum of section {section:?} is wrong: the file is damaged; copy it again or build it again",
        path.display()
    )]
    Checksum {
        /// Which file.
        path: PathBuf,
        /// Which section; `header` for the header and the table of sections.
        section: &'static str,
    },
    /// The checksums are right, and yet the content is no map: it was written by a faulty program.
    #[error("{}: section {section:?}: {reason}; build the map again", path.display())]
    Structure {
        /// Which file.
        path: PathBuf,
        /// Which section.
        section: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A map put together in memory does not hold together.
    #[error("the map does not hold together: {record} {reason}")]
    Model {
        /// Which part.
        record: Record,
        /// What is wrong.
        reason: String,
    },
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

impl MapError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }
}

fn in_dir(dir: Option<&Path>) -> String {
    dir.map_or_else(String::new, |d| format!(" in {}", d.display()))
}

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line of a text file, from 1.
    Line(usize),
    /// Byte of a binary file, from 0.
    Byte(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// A part of a model, by its number or name.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Record {
    /// A camera, by its COLMAP id or its index in the map.
    Camera(u32),
    /// An image, by its name.
    Image(String),
    /// An image, by its COLMAP id.
    ImageId(u32),
    /// A point, by its COLMAP id or its index in the map.
    Point(u64),
    /// The map as a whole.
    Map,
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Camera(id) => write!(f, "camera {id}"),
            Self::Image(name) => write!(f, "image {name:?}"),
            Self::ImageId(id) => write!(f, "image with id {id}"),
            Self::Point(id) => write!(f, "point {id}"),
            Self::Map => f.write_str("the map"),
        }
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
        expected: ObjectId,
        /// The id of what is there.
        found: ObjectId,
    },
}
