//! Internal: descriptors without positions, from kinds and nearest neighbours to global descriptors of images.
//!
//! This crate has no positions of descriptors; both the device and the server use it.
//!
//! - [`DescriptorKind`]: what the bytes of a descriptor mean, and all properties that depend on it. RootSIFT is built
//!   in; an extractor described at run time has its own kind.
//! - [`Descriptors`], [`DescriptorView`]: rows of bytes of one kind.
//! - [`two_nearest`], [`match_descriptors`]: exact nearest neighbours by brute force, for every kind.
//! - [`GlobalModel`]: how the [`GlobalDescriptor`] of an image is computed, by a [`Vocabulary`] from its rows or by an
//!   extractor known by name.
//! - [`GlobalIndex`]: finds global descriptors similar to a given one.
//!
//! All computations are in integers up to the last step, so results are the same on every machine and for any number of
//! threads.
//!
//! ```
//! use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding, MatchOptions, match_descriptors};
//!
//! // Unit vectors of 4 numbers, stored as signed bytes: 100 times the number.
//! let kind = DescriptorKind::new("my-network", 4, Encoding::Signed, 100)?;
//! let code = |vector: [f64; 4]| vector.map(|x| kind.encoding().byte(100.0 * x));
//! let query = Descriptors::new(kind, code([0.6, -0.8, 0.0, 0.0]).to_vec())?;
//! let database = Descriptors::new(kind, [code([0.0, 0.0, 1.0, 0.0]), code([0.64, -0.77, 0.0, 0.0])].concat())?;
//!
//! let matches = match_descriptors(query.view(), database.view(), &MatchOptions::default());
//! assert_eq!((matches[0].query, matches[0].database), (0, 1));
//! assert_eq!(matches[0].distance, 5.0);
//! # Ok::<(), veiloc_descriptor::DescriptorError>(())
//! ```
#![forbid(unsafe_code)]

mod binary_codes;
mod encoding;
mod error;
mod global;
mod global_model;
mod image_matches;
mod index;
mod kind;
mod kmeans;
mod matching;
mod name;
mod neighbours;
mod packed;
mod prior;
mod storage;
#[cfg(test)]
mod test_data;
mod vocabulary;

pub use encoding::Encoding;
pub use error::DescriptorError;
pub use global::GlobalDescriptor;
pub use global_model::{GlobalModel, NamedGlobal};
pub use image_matches::{
    PointImage, PointMatch, RANKS_OF_OTHER_PLACES, RETRIEVED_IMAGES, images_of_other_places, match_images,
};
pub use index::GlobalIndex;
pub use kind::DescriptorKind;
pub use matching::{Match, MatchOptions, match_descriptors};
pub use name::Name;
pub use neighbours::{Neighbour, SearchedRows, TwoNearest, two_nearest};
pub use prior::{MatchEvidence, MatchPrior, PriorModel, match_probability, probability};
pub use storage::{DescriptorView, Descriptors};
pub use vocabulary::Vocabulary;
