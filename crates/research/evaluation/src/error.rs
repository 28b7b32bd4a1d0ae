//! Errors of evaluations and audits, by their cause.

use std::path::PathBuf;

/// Why an evaluation or an audit could not run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    // Options.
    /// The options contradict each other or are incomplete.
    #[error("{0}")]
    Options(String),

    // Input data.
    /// A data set is incomplete or inconsistent.
    #[error("{0}")]
    DataSet(String),
    /// An image attacked by a server has no matches.
    #[error(
        "{image}: the server's problem file has no matches for this image; it must cover the same images"
    )]
    NoMatches {
        /// The image.
        image: String,
    },
    /// The matches of an image belong to an image of another size.
    #[error(
        "{image}: its matches are for {} x {} pixels, but its keypoints for {} x {}; use one image size",
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
    /// Descriptors of two kinds, or of a kind that a network was not trained on.
    #[error(
        "{name}: its descriptors are of kind {found}, but kind {expected} is required; extract them with --features {expected}"
    )]
    OtherFeatures {
        /// The file or the image.
        name: String,
        /// Name of the kind that it has.
        found: String,
        /// Name of the required kind.
        expected: String,
    },
    /// A match refers to a keypoint that the image does not have.
    #[error("{image}: a match refers to a keypoint at ({u}, {v}), but the image has none there")]
    NoSuchKeypoint {
        /// The image.
        image: String,
        /// Column of the keypoint, pixels.
        u: f64,
        /// Row of the keypoint, pixels.
        v: f64,
    },
    /// The server could not localize any image, so it knows only the sent queries.
    #[error(
        "{scheme}: no trustworthy pose was found for any of {images} images, so the server knows no position"
    )]
    NoPose {
        /// Obfuscation scheme.
        scheme: String,
        /// Number of images.
        images: usize,
    },
    /// An image could not be sealed.
    #[error("{name}: {source}")]
    Seal {
        /// The image.
        name: String,
        /// The cause.
        source: veiloc_obfuscation::SealError,
    },
    /// Nothing can be extracted from an image, or the scheme cannot obfuscate it.
    #[error(transparent)]
    Obfuscate(#[from] veiloc_obfuscation::SealError),

    // Files.
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
    /// A contact sheet cannot be written.
    #[error("the contact sheet cannot be written: {0}; show fewer images")]
    Sheet(String),

    // Errors of lower crates.
    /// A file of problems or keypoints could not be read.
    #[error(transparent)]
    Dataset(#[from] veiloc_datasets::DatasetError),
    /// An image cannot be read, features cannot be extracted, or the detector cannot run.
    #[error(transparent)]
    Features(#[from] veiloc_features::FeatureError),
    /// The map could not be built or tested.
    #[error(transparent)]
    Mapping(#[from] veiloc_mapping::MappingError),
    /// A map or model file could not be read or written.
    #[error(transparent)]
    Map(#[from] veiloc_map::MapError),
    /// An attack or a network cannot run, or an image metric cannot be computed.
    #[error(transparent)]
    Attack(#[from] veiloc_attacks::AttackError),
}
