//! What can be wrong with a network, its training, or its files.

use crate::AttackError;
use crate::training::TrainingError;
use veiloc_obfuscation::SealError;

/// Why there is no network.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The images do not fit.
    #[error(transparent)]
    Attack(#[from] AttackError),
    /// An image cannot be obfuscated under the scheme.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// An option makes no sense, training failed, or a file is none.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// There is nothing to learn or to attack where positions are sent, or nothing but one scheme was learned.
    #[error("{found}: {expected}")]
    Scheme {
        /// What was given.
        found: String,
        /// What would do.
        expected: String,
    },
}
