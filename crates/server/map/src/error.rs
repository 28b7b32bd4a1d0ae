//! Errors of maps, map files, regions and COLMAP models. Every message names the file and the remedy.

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
        /// The error of the system.
        source: std::io::Error,
    },
    /// A file of content anchors is invalid.
    #[error("{}: {source}", path.display())]
    Anchors {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and the remedy.
        source: veiloc_protocol::ContentAnchorError,
    },
    /// The folder does not hold a COLMAP model.
    #[error(
        "{}: no COLMAP model here: {wanted} are not all present, neither as .txt nor as .bin; {}",
        dir.display(), folder_to_give(inside)
    )]
    NoColmapModel {
        /// The folder.
        dir: PathBuf,
        /// Folders in it that hold a model.
        inside: Vec<PathBuf>,
        /// The missing files.
        wanted: &'static str,
    },
    /// A text model must not be written into a folder with a binary one.
    #[error(
        "{}: holds a binary COLMAP model, which would be read instead of the text; remove its .bin files, or give \
         another folder",
        dir.display()
    )]
    BinaryModelThere {
        /// The folder.
        dir: PathBuf,
    },
    /// A record of a COLMAP file is invalid.
    #[error("{}, {position}: {reason}", path.display())]
    Colmap {
        /// Which file.
        path: PathBuf,
        /// Where in the file.
        position: FilePosition,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Records of a COLMAP model are inconsistent.
    #[error("COLMAP model{}: {record} {reason}", in_dir(dir.as_deref()))]
    ColmapRecord {
        /// The folder of the model, if it was read from one.
        dir: Option<PathBuf>,
        /// Which record.
        record: ModelRecord,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Rigs and frames of a COLMAP model are inconsistent.
    #[error("COLMAP model in {}: rigs and frames: {reason}", dir.display())]
    ColmapRigs {
        /// The folder of the model.
        dir: PathBuf,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Posed images are inconsistent.
    #[error("the posed images are inconsistent: {record} {reason}")]
    PosedImages {
        /// Which image or point.
        record: ModelRecord,
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
    /// The map has another format version.
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
    /// The map has an unknown section.
    #[error("{}: section {code} of the map is unknown: it was written by a newer version; use a newer veiloc", path.display())]
    UnknownSection {
        /// Which file.
        path: PathBuf,
        /// The section's number.
        code: u32,
    },
    /// The file is shorter or longer than its header states.
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
        /// The length in the header, or the minimum length of a map.
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
    /// The checksums are valid, but the content is not: a faulty program wrote it.
    #[error("{}: section {section:?}: {reason}; build the map again", path.display())]
    Structure {
        /// Which file.
        path: PathBuf,
        /// Which section.
        section: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A map in memory is inconsistent.
    #[error("the map is inconsistent: {record} {reason}")]
    Model {
        /// Which part.
        record: ModelRecord,
        /// What is wrong.
        reason: String,
    },
    /// The map cannot be cut with these options.
    #[error("the map cannot be cut: {reason}")]
    Cut {
        /// Why, and the remedy.
        reason: String,
    },
    /// Invalid map name.
    #[error("{name:?} is not a valid map name: use 1 to 64 letters, digits, `-`, `_` and `.`")]
    Name {
        /// The name.
        name: String,
    },
    /// The folder has no regions.
    #[error("{}: no regions here; `veiloc map split MAP --out DIR` creates such a folder", path.display())]
    NoRegions {
        /// The missing manifest.
        path: PathBuf,
    },
    /// Invalid manifest.
    #[error("{from}: {source}")]
    Manifest {
        /// The file or address it was read from.
        from: String,
        /// What is wrong.
        source: ManifestError,
    },
    /// Invalid index.
    #[error("{}: {reason}; cut the map again with `veiloc map split`", path.display())]
    Index {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The index has another version.
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
    /// The content of a file does not match its name.
    #[error(
        "{}: found {found} instead of the object {} of {} bytes; the file is damaged: fetch it again, or cut the map again",
        path.display(),
        expected.sha256,
        expected.bytes
    )]
    Object {
        /// Which file.
        path: PathBuf,
        /// The expected object.
        expected: ObjectRef,
        /// The content that was found.
        found: String,
    },
    /// A valid object does not match the manifest.
    #[error("{}: {reason}: the manifest does not match its objects; cut the map again", path.display())]
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

/// The remedy for a folder without a model.
fn folder_to_give(inside: &[PathBuf]) -> String {
    match inside {
        [] => "give the folder that holds them".to_owned(),
        [model] => format!("give the model in it: {}", model.display()),
        [first, others @ ..] => {
            format!("give one of the {} models in it, for example {}", others.len() + 1, first.display())
        }
    }
}

fn in_dir(dir: Option<&Path>) -> String {
    dir.map_or_else(String::new, |d| format!(" in {}", d.display()))
}

/// A position in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilePosition {
    /// Line of a text file, from 1.
    Line(usize),
    /// Byte of a binary file, from 0.
    Byte(usize),
}

impl fmt::Display for FilePosition {
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
pub enum ModelRecord {
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

impl fmt::Display for ModelRecord {
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

/// Errors of a manifest.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// The manifest is too long.
    #[error("a manifest of more than {most} bytes; veiloc never writes such a manifest")]
    TooLong {
        /// Most bytes.
        most: usize,
    },
    /// Not JSON, or not a manifest.
    #[error("not a manifest of regions: {0}; `veiloc map split` makes one")]
    Json(#[from] serde_json::Error),
    /// Unknown version.
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
    /// Well-formed, but inconsistent.
    #[error("an impossible manifest: {reason}; cut the map again with `veiloc map split`")]
    Impossible {
        /// What is wrong.
        reason: String,
    },
    /// The same content in another form; it would have two ids.
    #[error("not in the canonical form of a manifest, so its id is ambiguous; cut the map again")]
    SecondForm,
    /// It belongs to another map.
    #[error("the manifest belongs to map {found:?}, expected {expected:?}; publish the map again")]
    OtherMap {
        /// Expected map.
        expected: String,
        /// Map of the manifest.
        found: String,
    },
    /// It is another manifest than requested.
    #[error("found manifest {found}, expected {expected}; fetch it again")]
    OtherId {
        /// Expected id.
        expected: ObjectId,
        /// Id of the manifest that was found.
        found: ObjectId,
    },
}
