//! What can be wrong with a map, a map file or a COLMAP model. Every message names the file and says what to do.

use std::fmt;
use std::path::{Path, PathBuf};

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
