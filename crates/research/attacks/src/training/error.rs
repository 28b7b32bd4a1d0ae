//! What can be wrong with a training, or with the file of a network.

/// Why there is no training, or no network.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingError {
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
    /// The bytes do not begin as such a file does.
    #[error("this is no {expected}")]
    NotANetwork {
        /// What was to be read, and what writes it.
        expected: &'static str,
    },
    /// The file is of another version.
    #[error("the file is of version {found}, this program reads version {expected}; train again")]
    Version {
        /// The version in the file.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file is cut short, or too long.
    #[error("the file has {found} bytes, {expected} are expected; copy it again")]
    Length {
        /// Bytes that are there.
        found: usize,
        /// Bytes that such a file has.
        expected: u64,
    },
    /// The bytes are not those that were written.
    #[error("the file is damaged (checksum); copy it again")]
    Checksum,
    /// A learned number is not finite.
    #[error("the file holds a number that is not finite; train again")]
    NotFinite,
    /// A training cannot go on with other options or images than it began with.
    #[error("the training that is to go on was begun with other options or images; begin anew without it")]
    OtherTraining,
}

impl TrainingError {
    /// What is wrong with a whole number.
    pub fn refuse(name: &'static str, value: usize, allowed: &'static str) -> Self {
        Self::Option { name, value: value as f64, allowed }
    }
}
