//! Reads and writes hloc's files: features of other programs can be localized here, and features extracted here can be
//! used there.
//!
//! - [`FeaturesFile`]: `feats-….h5`, keypoints and descriptors by image name; [`write_features`].
//! - [`StoredFeatures`]: such a file instead of an extractor ([`veiloc_features::FeatureStore`]).
//! - [`MatchesFile`]: `matches-….h5`; [`write_matches`]. [`GlobalsFile`]: `global-feats-….h5`; [`write_globals`].
//! - [`read_pairs`], [`write_pairs`]: lists of pairs.
//!
//! All formats except lists of pairs are HDF5 and need the cargo feature `hloc`.
//!
//! hloc's pixel coordinates have their origin at the centre of the first pixel; here they are COLMAP's, half a pixel
//! more ([`veiloc_geometry::Pixel::from_center_at_zero`]). Numbers may be float16, float32 or float64, as with hloc's
//! `as_half`, stored contiguously or in chunks, with or without gzip.
//!
//! A file may be untrusted: shapes, chunks and lengths are bounded before anything is read, recursive groups end at a
//! maximum depth, and an invalid entry is an error that names the file, the image and the remedy (`tests/hostile.rs`).
//!
//! ```
//! use veiloc_geometry::Pixel;
//! use veiloc_mapping::importers::hloc::{FeaturesFile, ImageFeatures, Vectors, write_features};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("feats.h5");
//! let features = ImageFeatures {
//!     keypoints: vec![Pixel::new(0.5, 0.5), Pixel::new(20.5, 11.25)],
//!     scores: Some(vec![0.5, 0.25]),
//!     descriptors: Vectors { dim: 3, values: vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0] },
//!     image_size: Some((640, 480)),
//!     uncertainty: None,
//! };
//! write_features(&path, [("db/a.jpg".to_owned(), features.clone())])?;
//! let file = FeaturesFile::open(&path)?;
//! assert_eq!(file.names()?, ["db/a.jpg"]);
//! assert_eq!(file.read("db/a.jpg")?, features);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

#[cfg(feature = "hloc")]
mod archive;
#[cfg(feature = "hloc")]
mod binary16;
#[cfg(feature = "hloc")]
mod features;
#[cfg(feature = "hloc")]
mod globals;
#[cfg(feature = "hloc")]
mod matches;
#[cfg(feature = "hloc")]
mod numbers;
mod pairs;
#[cfg(feature = "hloc")]
mod stored;
#[cfg(feature = "hloc")]
mod write;

#[cfg(feature = "hloc")]
pub use features::{FeaturesFile, ImageFeatures, Vectors, check_feature_names, write_features};
#[cfg(feature = "hloc")]
pub use globals::{GlobalsFile, write_globals};
#[cfg(feature = "hloc")]
pub use matches::{KeypointMatch, MatchesFile, write_matches};
pub use pairs::{check_pair_name, read_pairs, write_pairs};
#[cfg(feature = "hloc")]
pub use stored::StoredFeatures;
