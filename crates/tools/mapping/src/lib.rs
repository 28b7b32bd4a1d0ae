//! Internal: builds maps from posed images: pairs, matching, tracks, triangulation.
//!
//! ```text
//! images ── features ── pairs ── matches ── epipolar check ── tracks ── triangulation ── completion ── map
//!                            from the poses      with the poses
//! ```
//!
//! For an operator's tools, and for evaluation on data with known poses.
//!
//! - [`Input`]: the posed images, their files, and the treatment of unusable images.
//! - [`build`]: builds a map from images with known poses.
//! - [`prepare`]: computes one share of a distributed build.
//! - [`add`], [`remove`]: add and remove images; unaffected points stay bit-identical.
//! - [`align`]: transforms a map to another world frame; [`merge`] joins two maps.
//! - [`import`]: imports a complete COLMAP model with its points and observations.
//! - [`compress`]: keeps the most useful points, each with a few of its descriptors.
//! - [`coverage`]: where in a place, and how exactly, a camera is expected to be localized.
//! - [`HoldOutMap`]: the map without some of its images.
//! - [`finish`]: the end of all of them: tests the map, which calibrates its ±, and refuses a broken one.
//! - [`structure_from_motion`]: poses of images without poses, by pycolmap or COLMAP.
//! - [`importers::poses`]: poses of other programs; [`importers::ros_bag`]: images with poses of a bag.
//! - [`BuildReport`]: the result of a build, and every [`MapWarning`] about the map.
//!
//! Poses are fixed: only points are refined. Results do not depend on the number of threads or on timing.
//!
//! ```no_run
//! use std::path::Path;
//! use veiloc_map::colmap::read_posed;
//! use veiloc_mapping::{BuildOptions, FinishOptions, Input, OnBadImage, build, finish};
//!
//! let posed = read_posed(Path::new("hall/sparse"))?;
//! let input = Input::new(&posed, Path::new("hall/images")).on_bad_image(OnBadImage::Skip);
//! let (mut map, mut report) = build(&input, &BuildOptions::default(), &())?;
//! finish(&mut map, &mut report.warnings, &FinishOptions::default(), &())?;
//! for warning in &report.warnings {
//!     println!("warning: {warning}");
//! }
//! veiloc_map::write(&map, Path::new("hall.vmap"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! All unusable images are named before any computation:
//!
//! ```
//! use veiloc_map::PosedImages;
//! use veiloc_mapping::{BuildOptions, Input, MappingError, build};
//!
//! let posed = PosedImages::default();
//! let names = ["hall/1.jpg".to_owned(), "hall/2.jpg".to_owned()];
//! let input = Input::new(&posed, "photos".as_ref()).with_names(&names);
//! let Err(MappingError::BadImages(bad)) = build(&input, &BuildOptions::default(), &()) else { panic!() };
//! assert_eq!(bad.images.len(), 2);
//! assert!(bad.to_string().starts_with("2 of 2 images cannot be used\n  hall/1.jpg: there is no pose for it"));
//! ```
#![forbid(unsafe_code)]

pub mod align;
mod build;
pub mod build_cache;
pub mod calibration;
mod compress;
mod coordinate_frames;
pub mod coverage;
mod error;
pub mod importers;
mod input;
mod progress;
mod python;
pub mod structure_from_motion;
mod triangulation;

pub use build::build;
pub use build::change::{VocabularyUpdate, add, remove};
pub use build::finish::{FinishOptions, finish, finish_tested, refuse_broken_compressed};
pub use build::import::{ImportReport, import};
pub use build::merge::{MergeReport, merge};
pub use build::prepare::{BuildStage, ShareSummary, StageShare, prepare};
pub use build::report::{BuildReport, InputMistake, MapWarning};
pub use compress::{CompressOptions, CompressedMap, compress};
pub use coordinate_frames::{CoordinateFrameReport, OtherCoordinateFrame, Similarity3};
pub use error::MappingError;
pub use input::bad_image::{BadImage, BadImages, BadReason, SkippedImages};
pub use input::cache::{BuildCache, ExtractedFeatures, FeatureRequest};
pub use input::image_names::{NameIndex, image_file, mask_file};
pub use input::masks::MaskFacts;
pub use input::options::BuildOptions;
pub use input::{Input, OnBadImage, OnOtherCoordinateFrame};
pub use progress::Progress;
pub use triangulation::hold_out::HoldOutMap;

#[cfg(test)]
mod tests;
