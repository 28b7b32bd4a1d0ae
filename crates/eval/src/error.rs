//! What can go wrong in an evaluation, and whose fault it is.

use std::path::PathBuf;

/// Why an evaluation could not run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of a JSON-lines file is not what it should be.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that should hold something is empty.
    #[error("{}: {what}", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
        /// What is missing, and the remedy.
        what: &'static str,
    },
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
    /// A data set is not whole.
    #[error("{0}")]
    DataSet(String),
    /// Features of a query could not be extracted.
    #[error(transparent)]
    Extract(#[from] veiloc_obfuscation::ExtractError),
    /// An image could not be sealed.
    #[error("{name}: {source}")]
    Seal {
        /// The image.
        name: String,
        /// Why.
        source: veiloc_obfuscation::SealError,
    },
    /// An image that is attacked by a server has no matches.
    #[error("{image}: no problem with matches has this name; the server's file must be of the same images")]
    NoMatches {
        /// The image.
        image: String,
    },
    /// Matches of an image are of an image of another size.
    #[error(
        "{image}: its matches are of {} x {} pixels, its keypoints of {} x {}",
        size[0], size[1], expected[0], expected[1]
    )]
    OtherSize {
        /// The image.
        image: String,
        /// Width and height in the file of matches, pixels.
        size: [u32; 2],
        /// Width and height in the file of keypoints, pixels.
        expected: [u32; 2],
    },
    /// A match is of a keypoint that the image does not have.
    #[error("{image}: a match is of a keypoint at ({u}, {v}), and the image has none there")]
    NoSuchKeypoint {
        /// The image.
        image: String,
        /// Column of the keypoint, pixels.
        u: f64,
        /// Row of the keypoint, pixels.
        v: f64,
    },
    /// The server could not localize any image, so it knows nothing beside what was sent.
    #[error(
        "{scheme}: no trustworthy pose was found for any of {images} images, so the server knows no position"
    )]
    NoPose {
        /// Obfuscation scheme.
        scheme: String,
        /// How many images were tried.
        images: usize,
    },
    /// An attack could not run.
    #[error(transparent)]
    Attack(#[from] veiloc_attacks::AttackError),
    /// A network that predicts neighbours could not be trained or read.
    #[cfg(feature = "network")]
    #[error(transparent)]
    Network(#[from] veiloc_attacks::network::NetworkError),
    /// The map could not be built.
    #[error(transparent)]
    Mapping(#[from] veiloc_mapping::MappingError),
    /// A map or model file could not be read or written.
    #[error(transparent)]
    Map(#[from] veiloc_map::MapError),
}
