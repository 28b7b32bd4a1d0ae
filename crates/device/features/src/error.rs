//! What can be wrong with an image.

use std::path::PathBuf;

/// Why an image was refused. The message names the file, where there is one, and what to do about it.
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
