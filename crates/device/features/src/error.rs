//! What can be wrong with an image, its mask, or what is to make features of it.

use std::path::PathBuf;

use crate::ProjectionError;

/// Why there are no features: an image or a mask is refused, or a network or a detector cannot be used. The message names the file, where there is one, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}; check the path and the permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is no image, is cut short, or is of a kind that is not supported.
    #[error("cannot decode {}: {reason}; expected a complete JPEG or PNG file, export or copy it again", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// The image has more pixels than we are ready to hold in memory.
    #[error(
        "{} has {width}x{height} pixels, more than {max_pixels}; scale it down first",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its width, pixels.
        width: u32,
        /// Its height, pixels.
        height: u32,
        /// The limit, pixels in all.
        max_pixels: u64,
    },
    /// The image is not of the size its camera takes.
    #[error(
        "{}: {}x{} pixels, but its camera takes {}x{}; {}give the camera of this image, or the image as the camera took it, \
         neither scaled nor turned",
        path.display(), actual.0, actual.1, camera.0, camera.1, turn_note(*turn)
    )]
    ImageSize {
        /// The file.
        path: PathBuf,
        /// Its width and height, pixels.
        actual: (u32, u32),
        /// Width and height of the camera's images, pixels.
        camera: (u32, u32),
        /// By how many degrees clockwise the file says it is to be turned, when it fits the camera turned.
        turn: Option<u16>,
    },
    /// The camera was to be found in the file's EXIF, and is not.
    #[error(
        "{}: {reason}; give its camera (MODEL,WIDTH,HEIGHT,PARAMS…), or let the focal length be guessed and say that it is \
         unknown",
        path.display()
    )]
    NoFocal {
        /// The file.
        path: PathBuf,
        /// Why EXIF does not tell.
        reason: &'static str,
    },
    /// A mask of another size than the image.
    #[error(
        "{} has {}x{} pixels and its image {}x{}; give a mask of the image as it is stored, neither scaled nor turned",
        name_of(file.as_ref()), mask.0, mask.1, image.0, image.1
    )]
    MaskSize {
        /// The mask's file, when it is of one.
        file: Option<PathBuf>,
        /// Width and height of the mask, pixels.
        mask: (u32, u32),
        /// Width and height of the image, pixels.
        image: (u32, u32),
    },
    /// A mask that hides nothing: nobody means that.
    #[error("{} hides nothing; black hides, in a mask of the size of the image", name_of(mask.as_ref()))]
    HidesNothing {
        /// Its file, when it is of one.
        mask: Option<PathBuf>,
    },
    /// A mask that hides everything.
    #[error("{} hides the whole image; black hides, and what may be sent is white", name_of(mask.as_ref()))]
    HidesAll {
        /// Its file, when it is of one.
        mask: Option<PathBuf>,
    },
    /// A mask with transparent pixels.
    #[error(
        "{}: the mask has transparent pixels, of which nobody knows whether they are to hide; say it with black and white",
        mask.display()
    )]
    MaskTransparent {
        /// Its file.
        mask: PathBuf,
    },
    /// No extractor makes such features.
    #[error("no features of kind {asked} here; there are: {known}")]
    UnknownKind {
        /// What was asked for.
        asked: String,
        /// The names of those there are.
        known: String,
    },
    /// An extractor could not run, or broke its promise.
    #[error("features of kind {name}: {reason}")]
    Extractor {
        /// The extractor's name.
        name: String,
        /// What went wrong.
        reason: String,
    },
    /// Width or height is zero.
    #[error("the image is empty ({width}x{height}); width and height must be at least 1")]
    Empty {
        /// Its width, pixels.
        width: u32,
        /// Its height, pixels.
        height: u32,
    },
    /// The samples do not fill the stated size.
    #[error("{width}x{height} pixels need {expected} samples, there are {actual}")]
    Length {
        /// Stated width, pixels.
        width: u32,
        /// Stated height, pixels.
        height: u32,
        /// `width * height * channels`
        expected: usize,
        /// What was given.
        actual: usize,
    },
    /// A sample is NaN or infinite.
    #[error("the sample at column {column}, row {row} is not finite; replace it before extraction")]
    NotFinite {
        /// Column of the first such sample.
        column: u32,
        /// Row of the first such sample.
        row: u32,
    },
    /// The file is no network, is damaged, or is of another form than its description says.
    #[error("{}: this network cannot be used: {reason}", path.display())]
    Network {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that a description names as the projection of its descriptors, and is not.
    #[error("{}: this projection cannot be used: {source}", path.display())]
    Projection {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ProjectionError,
    },
    /// A description that says what cannot be.
    #[error("{}: this describes no model: {reason}", path.display())]
    Description {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No model of this name is known.
    #[error(
        "no features of the name {name:?} are known; there are: {known}, or give the .toml file that describes a network"
    )]
    UnknownFeatures {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// The model is known, its file was not found.
    #[error(
        "the model {name} needs its file ({files}), which is not there; get it from {source_of} and name it with \
         --model-file, or put it into a folder that VEILOC_MODELS names; looked for in: {looked}"
    )]
    NoModelFile {
        /// The model.
        name: String,
        /// Names of files that would do.
        files: String,
        /// Where it is got, and on what terms.
        source_of: Box<str>,
        /// Folders, or that there are none.
        looked: Box<str>,
    },
    /// No engine of this name is known.
    #[error("no engine of the name {name:?} is known; there are: {known}")]
    UnknownEngine {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// No model of global descriptors has this name.
    #[error(
        "no global descriptor of the name {name:?} is known; there are: vlad, {known}, or give the .toml file that describes one"
    )]
    UnknownGlobal {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// The model of global descriptors is known, one of its files was not found.
    #[error(
        "the global descriptor {name} needs its file ({files}), which is not there; get it from {source_of} and put it into a \
         folder that VEILOC_MODELS names; looked for in: {looked}"
    )]
    NoGlobalFile {
        /// The model.
        name: String,
        /// Names of files that would do.
        files: String,
        /// Where it is got, and on what terms.
        source_of: Box<str>,
        /// Folders, or that there are none.
        looked: Box<str>,
    },
    /// The network broke on an image.
    #[error("the network could not run: {reason}")]
    NetworkRun {
        /// What it said.
        reason: String,
    },
    /// The file could not be read.
    #[error("cannot read the detector {}: {source}; check the path and the permissions", path.display())]
    ReadDetector {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is no model, is damaged, or needs what is not here.
    #[error("{}: this is no detector that can be used: {reason}; give an ONNX file of YOLO's form", path.display())]
    Detector {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The detector broke on an image.
    #[error("the detector could not run: {reason}")]
    DetectorRun {
        /// What it said.
        reason: String,
    },
    /// A class that the detector does not know.
    #[error("the detector knows no class {asked}; it knows: {known}")]
    UnknownClass {
        /// What was asked for.
        asked: String,
        /// The names of those it knows.
        known: String,
    },
    /// No class was named.
    #[error("no class to hide; the detector knows: {known}")]
    NoClass {
        /// The names of those it knows.
        known: String,
    },
}

fn name_of(mask: Option<&PathBuf>) -> String {
    mask.map_or_else(|| "the mask".to_owned(), |path| format!("{}: the mask", path.display()))
}

fn turn_note(turn: Option<u16>) -> String {
    turn.map_or_else(String::new, |degrees| {
        format!(
            "the file says it is to be turned by {degrees}\u{b0}, which is not done here, as COLMAP does not: coordinates \
             are those of the stored pixels; "
        )
    })
}
