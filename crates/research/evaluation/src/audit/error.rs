//! Why an audit could not run, and whose fault it is.

use std::path::PathBuf;

/// Why an audit could not run.
#[derive(Debug, thiserror::Error)]
pub enum AuditError {
    /// A file could not be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of keypoints or problems could not be read.
    #[error(transparent)]
    Dataset(#[from] veiloc_datasets::DatasetError),
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
    /// Files do not go together.
    #[error("{0}")]
    DataSet(String),
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
    /// A network could not be trained or read.
    #[error(transparent)]
    Network(#[from] veiloc_attacks::learned::NetworkError),
}
