//! Errors of building, changing and testing maps, and of reading other programs' files. Every message names the file
//! and the remedy.

use std::path::{Path, PathBuf};

use veiloc_descriptor::DescriptorError;
use veiloc_features::FeatureError;
use veiloc_map::MapError;
use veiloc_obfuscation::SealError;
use veiloc_protocol::QueryError;

use crate::input::bad_image::BadImages;

/// What is looked for in a folder or file of posed images.
const LOOKED_FOR: &str = "looked for: a COLMAP model (cameras and images, also in sparse/0), transforms.json \
                          (nerfstudio), bundle.out, .nvm, reconstruction.json (OpenSfM), Metashape's XML, RealityCapture's CSV, \
                          sensors/sensors.txt (kapture), mav0 (EuRoC), trajectories of TUM and KITTI, captures of Polycam, \
                          Record3D and 3D Scanner App";

/// Errors of building, changing and testing maps, and of reading and writing hloc's files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// Content anchors cannot be carried.
    #[error(transparent)]
    Anchors(#[from] veiloc_protocol::ContentAnchorError),
    /// The list has no image.
    #[error(
        "there are no images: the list is empty, or the folder holds no JPEG, PNG, WebP or HEIC; name at least one"
    )]
    EmptyList,
    /// None of the given pairs consists of mapped images.
    #[error(
        "none of the {given} given pairs consists of two of the {images} mapped images; give pairs with \
         the names of the posed images"
    )]
    NoPairs {
        /// Number of given pairs.
        given: usize,
        /// Number of mapped images.
        images: usize,
    },
    /// No image has a mask in the folder of masks.
    #[error("{}: no image has a mask there; the mask of the first is {}", folder.display(), expected.display())]
    NoMasks {
        /// The folder.
        folder: PathBuf,
        /// The mask of the first image.
        expected: PathBuf,
    },
    /// Images cannot be used.
    #[error("{0}")]
    BadImages(BadImages),
    /// Nothing can be localized in a map that was made or changed.
    #[error("nothing can be localized in this map of {points} points{}", lines(warnings))]
    Broken {
        /// Number of its points.
        points: usize,
        /// What is known about the cause.
        warnings: Vec<String>,
    },
    /// The poses of images are in another coordinate frame than the rest of the map.
    #[error("{}", other_coordinate_frames(groups))]
    OtherCoordinateFrame {
        /// Each group of images, and its distance from the coordinate frame of the map.
        groups: Vec<String>,
    },
    /// The poses of most added images disagree with the map, and no transform to its coordinate frame explains them.
    #[error(
        "{} localized in the map with other poses than the given ones ({} of {localized} localized images), and no \
         common transform explains it, so nothing was changed; check the poses and cameras",
        names_are(names),
        names.len()
    )]
    PosesDisagree {
        /// Names of the images.
        names: Vec<String>,
        /// Number of localized images.
        localized: usize,
    },
    /// Images to remove are not in the map.
    #[error(
        "{} not in the map, so nothing was removed; `veiloc map info --images` lists the names",
        names_are(names)
    )]
    NotInMap {
        /// Their names.
        names: Vec<String>,
    },
    /// An image to remove occurs twice.
    #[error("{name} is in the list twice; list every image once")]
    DuplicateName {
        /// Its name.
        name: String,
    },
    /// Both maps of a merge have an image of this name.
    #[error("both maps have an image {name}; give a prefix for the names of the second one")]
    NameInBothMaps {
        /// Its name.
        name: String,
    },
    /// No image would be left to train a vocabulary on.
    #[error("no image would remain to train a vocabulary on; delete the map instead")]
    NothingLeft,
    /// The extractor of the features does not exist or cannot be used.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The map's global descriptors need an extractor that this program does not have.
    #[error(
        "the map's global descriptors are computed from the images by {name}, which this program does not \
         have"
    )]
    GlobalOfImage {
        /// The extractor's name.
        name: String,
    },
    /// No image has keypoints.
    #[error(
        "no usable keypoints in {images} images: {source}; check that they are the right files and \
         not blank"
    )]
    NoKeypoints {
        /// Number of images.
        images: usize,
        /// Error of the vocabulary training.
        source: DescriptorError,
    },
    /// No point could be triangulated.
    #[error(
        "no point could be triangulated from {images} images ({matches} matches, {verified} of them agree with \
         the poses); {}",
        cause.as_ref().map_or_else(
            || "check that the images overlap, from different positions, and that the poses are \
                world-to-camera".to_owned(),
            Clone::clone
        )
    )]
    NoPoints {
        /// Number of images.
        images: usize,
        /// Number of matches by descriptors.
        matches: usize,
        /// Number of matches that agree with the poses.
        verified: usize,
        /// The likely cause, if found.
        cause: Option<String>,
    },
    /// The COLMAP model has nothing to import.
    #[error(
        "the COLMAP model has {points} points, and no detected keypoint is near any of their \
         observations; check that these are the images of the model. To triangulate points from the \
         poses, build a map instead"
    )]
    NothingImported {
        /// Points of the model.
        points: usize,
    },
    /// The map is compressed and lacks the keypoints for a change.
    #[error(
        "the map is compressed or a region of a larger one: images cannot be added or removed, and it \
         cannot be compressed further; change the original map, and compress or split it again"
    )]
    Compressed,
    /// The requested size of a compressed map is too small.
    #[error(
        "{bytes} bytes are too few: poses, names and global descriptors of the images need {least}; allow \
         more, or build a map of fewer images"
    )]
    TooSmall {
        /// Requested bytes.
        bytes: u64,
        /// Bytes of the map without any point.
        least: u64,
    },
    /// The limits for devices are out of range.
    #[error(transparent)]
    Profile(#[from] QueryError),
    /// The map is inconsistent, or a setting is out of its range.
    #[error(transparent)]
    Map(#[from] MapError),
    /// No device could seal a query for the map.
    #[error("no query can be sealed for the map, so the self-test is impossible: {0}")]
    Seal(#[from] SealError),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file, or the folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not an HDF5 file, or is truncated or damaged.
    #[error("{}: not a complete HDF5 file: {reason}; copy it again, or write it again with hloc", path.display())]
    NotHdf5 {
        /// The file.
        path: PathBuf,
        /// The message of the HDF5 reader.
        reason: String,
    },
    /// The file has no entry of this name.
    #[error("{}: contains no {what} of {name}; give the file that was extracted from this image", path.display())]
    MissingInFile {
        /// The file.
        path: PathBuf,
        /// The kind of entry that was searched.
        what: &'static str,
        /// Name of the image, or of the pair.
        name: String,
    },
    /// An entry of the file is invalid.
    #[error("{}: {name}: {reason}", path.display())]
    BadInFile {
        /// The file.
        path: PathBuf,
        /// Name of the image or pair, with the name of its dataset.
        name: String,
        /// The problem and the remedy.
        reason: String,
    },
    /// A line of a list of pairs is invalid.
    #[error("{}: line {line}: {reason}", path.display())]
    PairsLine {
        /// The list.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The problem and the remedy.
        reason: String,
    },
    /// A line of a file of poses or of a list is invalid.
    #[error("{}:{line}: {reason}", path.display())]
    PosesLine {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The problem and the remedy.
        reason: String,
    },
    /// Posed images of another program cannot be used.
    #[error("{}: {reason}", path.display())]
    Poses {
        /// The file or folder.
        path: PathBuf,
        /// The problem and the remedy.
        reason: String,
    },
    /// No format of posed images was recognized.
    #[error(
        "{}: no posed images are recognized {}; {LOOKED_FOR}; without given poses they are computed",
        path.display(),
        if *is_folder { "in this folder" } else { "in this file" }
    )]
    UnknownPoses {
        /// The file or folder.
        path: PathBuf,
        /// Whether it is a folder.
        is_folder: bool,
    },
    /// The poses of a program that is known and not read.
    #[error("{}: {what} is not read; {remedy}", path.display())]
    UnreadPoses {
        /// The file.
        path: PathBuf,
        /// What the file is.
        what: &'static str,
        /// What to give instead.
        remedy: &'static str,
    },
    /// A folder has posed images in several formats.
    #[error("{}: posed images of several formats are here; give one of them: {}", path.display(), formats(found))]
    AmbiguousPoses {
        /// The folder.
        path: PathBuf,
        /// Each format, and its file or folder.
        found: Vec<(String, PathBuf)>,
    },
    /// A map cannot be aligned, or two maps cannot be brought to one coordinate frame.
    #[error("the map cannot be aligned: {reason}")]
    Alignment {
        /// The problem and the remedy.
        reason: String,
    },
    /// Neither pycolmap nor COLMAP was found.
    #[error(
        "images without poses need structure from motion, and {} has no pycolmap{}; install it: {install}",
        python.display(),
        if *is_given { "" } else { ", and no program colmap is on the PATH" }
    )]
    NoSfmProgram {
        /// The Python that was searched.
        python: PathBuf,
        /// Whether the user named it.
        is_given: bool,
        /// The command that installs pycolmap.
        install: &'static str,
    },
    /// The frames of a video cannot be used.
    #[error("{}: {reason}", path.display())]
    Video {
        /// The file.
        path: PathBuf,
        /// The problem and the remedy.
        reason: String,
    },
    /// The images of a bag of ROS cannot be used.
    #[error("{}: {reason}", path.display())]
    Bag {
        /// The bag.
        path: PathBuf,
        /// The problem and the remedy.
        reason: String,
    },
    /// Structure from motion failed.
    #[error("structure from motion: {reason}")]
    Sfm {
        /// The problem and the remedy.
        reason: String,
    },
    /// An entry cannot be written.
    #[error("{name:?} cannot be written into an hloc file: {reason}")]
    Unwritable {
        /// Name of the image or pair.
        name: String,
        /// The reason.
        reason: String,
    },
}

impl MappingError {
    /// Wraps an I/O error of a file or folder.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}

/// The formats with their files, for messages.
fn formats(found: &[(String, PathBuf)]) -> String {
    let each: Vec<String> =
        found.iter().map(|(format, path)| format!("{} ({format})", path.display())).collect();
    each.join(", ")
}

/// Each text on a line of its own.
fn lines(texts: &[String]) -> String {
    texts.iter().flat_map(|text| ["\n  ", text]).collect()
}

fn other_coordinate_frames(groups: &[String]) -> String {
    format!(
        "the poses of some images are in another coordinate frame than the rest of the map, so nothing was written; the \
         map without them localizes them with other poses{}",
        lines(groups)
    )
}

/// `a, b and 3 more are`, for messages.
fn names_are(names: &[String]) -> String {
    let listed = names.iter().take(10).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len() {
        0..=1 => format!("{listed} is"),
        2..=10 => format!("{listed} are"),
        more => format!("{listed} and {} more are", more - 10),
    }
}
