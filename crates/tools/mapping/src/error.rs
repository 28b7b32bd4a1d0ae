//! Why a map could not be built, changed or tested, and what files of others were refused for. Every message names the file and says what to do.

use std::path::{Path, PathBuf};

use veiloc_descriptor::DescriptorError;
use veiloc_features::FeatureError;
use veiloc_map::MapError;
use veiloc_obfuscation::SealError;
use veiloc_protocol::QueryError;

use crate::bad_image::BadImages;
use crate::report::Doubt;

/// Why a map could not be built, changed or tested, or a file of hloc's not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// No image was named.
    #[error("the list of images is empty; name at least one")]
    EmptyList,
    /// None of the pairs that are given is of images that are mapped.
    #[error(
        "none of the {given} pairs that are given is of two of the {images} images that are mapped; give pairs with the names of \
         the posed images"
    )]
    NoPairs {
        /// Pairs that were given.
        given: usize,
        /// Images that are mapped.
        images: usize,
    },
    /// Images cannot be used.
    #[error("{0}")]
    BadImages(BadImages),
    /// Images that are to leave are not there.
    #[error(
        "{} not in the map, so nothing was removed; `veiloc map info --images` lists the names",
        are(names)
    )]
    NotInMap {
        /// Their names.
        names: Vec<String>,
    },
    /// An image that is to leave was named twice.
    #[error("{name} is in the list twice; name every image once")]
    DuplicateName {
        /// Its name.
        name: String,
    },
    /// No image would be left to learn a vocabulary from.
    #[error("no image would be left to learn a vocabulary from; delete the map instead")]
    NothingLeft,
    /// There is nothing that makes the features wanted.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The map's global descriptors are made of images, by an extractor that is not here.
    #[error(
        "the map's global descriptors are made of the images by {name}, which this program does not have"
    )]
    GlobalOfImage {
        /// The extractor's name.
        name: String,
    },
    /// Nothing to recognise was found in any image.
    #[error("no usable keypoints in {images} images: {source}; are they blank, or not the right files?")]
    NoKeypoints {
        /// How many there were.
        images: usize,
        /// What the vocabulary lacks.
        source: DescriptorError,
    },
    /// No point of the place could be triangulated.
    #[error(
        "no point could be triangulated from {images} images ({matches} matches, {verified} of them agree with \
         the poses); {}",
        cause.map_or_else(
            || "do the images overlap, from different places, and are the poses world-to-camera?".to_owned(),
            |cause| cause.to_string()
        )
    )]
    NoPoints {
        /// How many images.
        images: usize,
        /// Matches by descriptors.
        matches: usize,
        /// Those that agree with the poses.
        verified: usize,
        /// What is likely wrong, when it could be found out.
        cause: Option<Doubt>,
    },
    /// The model that is to be imported has nothing to import.
    #[error(
        "the COLMAP model has {points} points, and no keypoint found in the images lies near any of their \
         observations; are these the images of the model? To make points from poses alone, build a map instead"
    )]
    NothingImported {
        /// Points of the model.
        points: usize,
    },
    /// The map was made small, and keeps too little for that.
    #[error(
        "the map is a compressed one or a region of a larger one, which no image can join or leave, and which cannot be \
         made smaller: do it to the map that it was made of, and compress or cut that again"
    )]
    Compressed,
    /// A map cannot be made so small.
    #[error(
        "{bytes} bytes are too few: poses, names and global descriptors of the images take {least} alone; ask for more, \
         or build a map of fewer images"
    )]
    TooSmall {
        /// Bytes that were asked for.
        bytes: u64,
        /// Bytes that a map without any point has.
        least: u64,
    },
    /// The limits for devices are out of range.
    #[error(transparent)]
    Profile(#[from] QueryError),
    /// The map does not hold together, or a setting is out of its range.
    #[error(transparent)]
    Map(#[from] MapError),
    /// No device could seal a query for the map.
    #[error("no query can be sealed for the map, so it cannot test itself: {0}")]
    Seal(#[from] SealError),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file, or the folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no HDF5 file, or is cut short or damaged.
    #[error("{}: not a whole HDF5 file: {reason}; copy it again, or write it again with hloc", path.display())]
    NotHdf5 {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        reason: String,
    },
    /// The file holds nothing under this name.
    #[error("{}: holds no {what} of {name}; give the file that was made of this image", path.display())]
    MissingInFile {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// Name of the image, or of the pair.
        name: String,
    },
    /// What the file holds under a name is not what it should be.
    #[error("{}: {name}: {reason}", path.display())]
    BadInFile {
        /// The file.
        path: PathBuf,
        /// Name of the image or pair, with the name of its numbers.
        name: String,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// A line of a list of pairs is none.
    #[error("{}: line {line}: {reason}", path.display())]
    PairsLine {
        /// The list.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Something that is to be written cannot be.
    #[error("{name:?} cannot be written into a file of hloc's: {reason}")]
    Unwritable {
        /// Name of the image or pair.
        name: String,
        /// Why.
        reason: String,
    },
}

impl MappingError {
    /// What the system said of a file or folder.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}

/// `a, b and 3 more are`
fn are(names: &[String]) -> String {
    let told = names.iter().take(10).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len() {
        0..=1 => format!("{told} is"),
        2..=10 => format!("{told} are"),
        more => format!("{told} and {} more are", more - 10),
    }
}
