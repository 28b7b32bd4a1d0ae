//! Descriptors without positions: storage, distances, nearest neighbours, and the VLAD vocabulary.
//!
//! This room knows nothing of where a descriptor was seen; both the device and the server use it.
#![forbid(unsafe_code)]

mod error;
mod storage;

pub use error::DescriptorError;
pub use storage::{DescriptorKind, DescriptorView, Descriptors};
