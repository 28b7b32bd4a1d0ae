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
