//! Errors about an image, its mask, or an extractor.

use std::path::PathBuf;

use crate::ProjectionError;

/// Why there are no features: an invalid image or mask, or a network or detector that cannot be used. The message names
/// the file, where there is one, and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}; check the path and the permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The message of the operating system.
        source: std::io::Error,
    },
    /// The file is not an image, is truncated, or is of an unsupported type.
    #[error("cannot decode {}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// The caller stopped the extraction ([`Image::with_stop`](crate::Image::with_stop)).
    #[error("stopped on request")]
    Stopped,
    /// The image has more pixels than the limit.
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
        /// The limit, total number of pixels.
        max_pixels: u64,
    },
    /// The image is no panorama.
    #[error(
        "{}: {width}x{height} pixels; an equirectangular panorama is twice as wide as high, and at least 256 pixels wide",
        path.display()
    )]
    NoPanorama {
        /// The file.
        path: PathBuf,
        /// Its width, pixels.
        width: u32,
        /// Its height, pixels.
        height: u32,
    },
    /// The image does not have the size of its camera's images.
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
        /// Clockwise rotation by the file's EXIF orientation, degrees, when the rotated image fits the camera.
        turn: Option<u16>,
    },
    /// The camera was to be taken from the file's EXIF data, which does not contain it.
    #[error(
        "{}: {reason}; give its camera (MODEL,WIDTH,HEIGHT,PARAMS…), or let the focal length be guessed and say that it is \
         unknown",
        path.display()
    )]
    NoFocal {
        /// The file.
        path: PathBuf,
        /// Why EXIF does not give the focal length.
        reason: &'static str,
    },
    /// The mask and its image differ in size.
    #[error(
        "{} has {}x{} pixels and its image {}x{}; give a mask of the image as it is stored, neither scaled nor turned",
        name_of(file.as_ref()), mask.0, mask.1, image.0, image.1
    )]
    MaskSize {
        /// The mask's file, if any.
        file: Option<PathBuf>,
        /// Width and height of the mask, pixels.
        mask: (u32, u32),
        /// Width and height of the image, pixels.
        image: (u32, u32),
    },
    /// A mask that hides nothing, which is certainly a mistake.
    #[error("{} hides nothing; black hides, in a mask of the size of the image", name_of(mask.as_ref()))]
    HidesNothing {
        /// Its file, if any.
        mask: Option<PathBuf>,
    },
    /// A mask that hides everything.
    #[error(
        "{} hides the whole image, and nothing may be sent; in a mask file black hides, and what may be sent is white",
        name_of(mask.as_ref())
    )]
    HidesAll {
        /// Its file, if any.
        mask: Option<PathBuf>,
    },
    /// The margin of a mask is not possible.
    #[error("the margin of a mask is {margin}; it is a share of the longer side, from 0 to 1")]
    MaskMargin {
        /// The margin.
        margin: f32,
    },
    /// A mask with transparent pixels.
    #[error(
        "{}: the mask has transparent pixels, whose meaning is undefined; use black (hidden) and white (visible) only",
        mask.display()
    )]
    MaskTransparent {
        /// Its file.
        mask: PathBuf,
    },
    /// No extractor makes features of this kind.
    #[error("no extractor for features of kind {requested}; available: {known}")]
    UnknownKind {
        /// The requested kind.
        requested: String,
        /// The names of the available ones.
        known: String,
    },
    /// An extractor could not run, or returned invalid features.
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
    /// The number of samples does not match the size.
    #[error("{width}x{height} pixels need {expected} samples, but {actual} were given")]
    Length {
        /// Stated width, pixels.
        width: u32,
        /// Stated height, pixels.
        height: u32,
        /// `width * height * channels`
        expected: usize,
        /// The given number.
        actual: usize,
    },
    /// The rows of a frame overlap.
    #[error("rows of {row} bytes cannot begin every {stride} bytes; give the bytes from one row to the next")]
    Stride {
        /// Bytes of the pixels of a row.
        row: usize,
        /// Bytes from one row to the next, as given.
        stride: usize,
    },
    /// A sample is NaN or infinite.
    #[error("the sample at column {column}, row {row} is not finite; replace it before extraction")]
    NotFinite {
        /// Column of the first such sample.
        column: u32,
        /// Row of the first such sample.
        row: u32,
    },
    /// The file is not a network, is damaged, or does not match its description.
    #[error("{}: this network cannot be used: {reason}", path.display())]
    Network {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that a description names as the projection of its descriptors is invalid.
    #[error("{}: this projection cannot be used: {source}", path.display())]
    Projection {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ProjectionError,
    },
    /// An invalid description.
    #[error("{}: this is not a valid model description: {reason}", path.display())]
    Description {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No model has this name.
    #[error("unknown feature type {name:?}; known: {known}, or give the .toml file that describes a network")]
    UnknownFeatures {
        /// The requested name.
        name: String,
        /// The known names.
        known: String,
    },
    /// The file of a known model was not found.
    #[error(
        "the model {name} needs its file ({files}), which was not found; get it from {source_of} and name it with \
         --model-file, or put it into a folder that VEILOC_MODELS names; searched for in: {searched}"
    )]
    NoModelFile {
        /// The model.
        name: String,
        /// Possible file names.
        files: String,
        /// Where to get it, and its licence.
        source_of: Box<str>,
        /// The searched folders.
        searched: Box<str>,
    },
    /// No engine has this name.
    #[error("unknown engine {name:?}; known: {known}")]
    UnknownEngine {
        /// The requested name.
        name: String,
        /// The known names.
        known: String,
    },
    /// No model of global descriptors has this name.
    #[error(
        "unknown global descriptor {name:?}; known: vlad, {known}, or give the .toml file that describes one"
    )]
    UnknownGlobal {
        /// The requested name.
        name: String,
        /// The known names.
        known: String,
    },
    /// A file of a known model of global descriptors was not found.
    #[error(
        "the global descriptor {name} needs its file ({files}), which was not found; get it from {source_of} and put it \
         into a folder that VEILOC_MODELS names; searched: {searched}"
    )]
    NoGlobalFile {
        /// The model.
        name: String,
        /// Possible file names.
        files: String,
        /// Where to get it, and its licence.
        source_of: Box<str>,
        /// The searched folders.
        searched: Box<str>,
    },
    /// The network failed on an image.
    #[error("the network could not run: {reason}")]
    NetworkRun {
        /// Its message.
        reason: String,
    },
    /// The detector file could not be read.
    #[error("cannot read the detector {}: {source}; check the path and the permissions", path.display())]
    ReadDetector {
        /// The file.
        path: PathBuf,
        /// The message of the operating system.
        source: std::io::Error,
    },
    /// The file is not a detector, is damaged, or needs unsupported operations.
    #[error("{}: this detector cannot be used: {reason}; give an ONNX file in YOLO's format, or selfie_segmentation.tflite of MediaPipe", path.display())]
    Detector {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The bytes are not a network that segments people, or it is damaged.
    #[error(
        "the network that finds people cannot be used: {reason}; give selfie_segmentation.tflite of MediaPipe (in the npm \
         package @mediapipe/selfie_segmentation)"
    )]
    Segmenter {
        /// What is wrong with it.
        reason: String,
    },
    /// The detector failed on an image.
    #[error("the detector could not run: {reason}")]
    DetectorRun {
        /// Its message.
        reason: String,
    },
    /// An unknown class.
    #[error("the detector has no class {requested}; its classes: {known}")]
    UnknownClass {
        /// The requested class.
        requested: String,
        /// The names of its classes.
        known: String,
    },
    /// No class was given.
    #[error("no class to hide was given; the detector's classes: {known}")]
    NoClass {
        /// The names of its classes.
        known: String,
    },
}

fn name_of(mask: Option<&PathBuf>) -> String {
    mask.map_or_else(|| "the mask".to_owned(), |path| format!("{}: the mask", path.display()))
}

fn turn_note(turn: Option<u16>) -> String {
    turn.map_or_else(String::new, |degrees| {
        format!(
            "the file's EXIF orientation rotates the image by {degrees}\u{b0}, which is ignored here, as in COLMAP: \
             coordinates are those of the stored pixels; "
        )
    })
}
