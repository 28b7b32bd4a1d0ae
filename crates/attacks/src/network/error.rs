//! What can be wrong with a network, its training, or its file.

use crate::error::AttackError;

/// Why there is no network.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The images do not fit.
    #[error(transparent)]
    Attack(#[from] AttackError),
    /// An option, or a number in a file, is none of those allowed.
    #[error("{name} is {value}, allowed is {allowed}")]
    Option {
        /// Which.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// Training left the numbers that can be computed with.
    #[error("the loss of step {step} is not finite; a smaller learning rate may help")]
    Diverged {
        /// Step, from 0.
        step: usize,
    },
    /// The bytes do not begin as a network's do.
    #[error("this is no network of neighbours; `veiloc train neighbours` writes one")]
    NotANetwork,
    /// The file is of another version.
    #[error("the network is of version {found}, this program reads version {expected}; train it again")]
    Version {
        /// The version in the file.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file is cut short, or too long.
    #[error("the network's file has {found} bytes, {expected} are expected; copy it again")]
    Length {
        /// Bytes that are there.
        found: usize,
        /// Bytes that a network of this shape has.
        expected: u64,
    },
    /// The bytes are not those that were written.
    #[error("the network's file is damaged (checksum); copy it again")]
    Checksum,
    /// A learned number is not finite.
    #[error("the network's file holds a number that is not finite; train it again")]
    NotFinite,
}
