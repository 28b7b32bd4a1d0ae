//! Descriptors without positions: storage, distances, nearest neighbours, and the VLAD vocabulary.
//!
//! This room knows nothing of where a descriptor was seen; both the device and the server use it.
//!
//! - [`Descriptors`], [`DescriptorView`]: rows of bytes.
//! - [`two_nearest`], [`match_descriptors`]: exact nearest neighbours by brute force.
//! - [`Vocabulary`]: turns the descriptors of an image into one [`GlobalDescriptor`] for retrieval.
//!
//! Everything is computed in integers up to the last step, so results are the same on every machine and for every
//! number of threads.
#![forbid(unsafe_code)]

mod error;
mod global;
mod kmeans;
mod matching;
mod neighbours;
mod storage;
#[cfg(test)]
mod test_data;
mod vocabulary;

pub use error::DescriptorError;
pub use global::GlobalDescriptor;
pub use matching::{Match, MatchOptions, match_descriptors};
pub use neighbours::{Neighbour, TwoNearest, two_nearest};
pub use storage::{DescriptorKind, DescriptorView, Descriptors};
pub use vocabulary::Vocabulary;
