//! What can go wrong with inversion.

use crate::audit::AuditError;
use veiloc_attacks::image_metrics::JudgeError;
use veiloc_attacks::training::TrainingError;
use veiloc_datasets::DatasetError;
use veiloc_features::FeatureError;
use veiloc_obfuscation::SealError;

/// Why there is no network, or no image from one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InversionError {
    /// An option makes no sense, training failed, or a file is none.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// An image cannot be read, or the detector cannot run.
    #[error(transparent)]
    Image(#[from] FeatureError),
    /// A file of images or keypoints cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Images are both learned from and judged by.
    #[error(
        "{images} images are among those learned from and among those judged by; give images of different places"
    )]
    Shared {
        /// How many.
        images: usize,
    },
    /// An image cannot be obfuscated under the scheme.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// Descriptors are missing, or of another length than those learned from.
    #[error(
        "{image}: descriptors of {found} numbers where {expected} are expected; use the features it was trained with"
    )]
    Descriptors {
        /// The image.
        image: String,
        /// Length of its descriptors; 0 where it has none.
        found: usize,
        /// Length that was learned.
        expected: usize,
    },
    /// There is nothing to learn from, or nothing to choose the best step by.
    #[error("there are no images to {0}; give some with keypoints")]
    Nothing(&'static str),
    /// An attack cannot run on the images.
    #[error(transparent)]
    Attack(#[from] AuditError),
    /// An image cannot be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
    /// A contact sheet cannot be written.
    #[error("the contact sheet cannot be written: {0}; show fewer images")]
    Sheet(String),
    /// No network takes places.
    #[error("none of the networks takes places; train one with `veiloc train inversion`")]
    NoNetwork,
    /// Several networks would answer the same, and only one can.
    #[error("two of the networks are given {0}; give one, and evaluate the other by itself")]
    TwoNetworks(String),
    /// A network that is given no places was to learn which places are wrong.
    #[error(
        "which places are wrong is learned by networks that are given places, and this one is given {sees}; use --sees places"
    )]
    NoPlaces {
        /// What it is given.
        sees: &'static str,
    },
    /// A network that sees lines was not told the scheme, or another was.
    #[error("{found}: {expected}")]
    Scheme {
        /// What was given.
        found: String,
        /// What would do.
        expected: &'static str,
    },
}
