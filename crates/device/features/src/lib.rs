//! Internal: from an image to keypoints and descriptors, on the device and during map building.
//!
//! - [`extract_image`]: the entry point from a file to features, for any [`Extractor`].
//! - [`extract_loaded`]: the same for an image in memory.
//! - [`CameraFrame`]: a frame as the camera of a phone gives it, without a copy.
//! - [`Extractors`]: the extractors of a program, by name. SIFT and [`Compact`] are built in; add your own with
//!   [`Extractors::with`].
//! - [`GlobalExtractor`]: computes one vector per image; none is built in.
//! - [`Mask`]: hidden parts of an image; [`Image::without`] removes them.
//! - [`PersonSegmenter`]: the people of an image as a [`Mask`].
//! - [`exif_camera`]: the camera from a file's EXIF data, for uncalibrated images.
//! - [`extract_sift`]: SIFT on an image in memory.
//!
//! This crate handles keypoints as plain positions; the crates of the server do not depend on it.
//!
//! ```
//! use veiloc_features::{Extractors, GrayImage, Image};
//!
//! // A bright square on a dark background has corners.
//! let samples = (0..64 * 64).map(|i| if (20..44).contains(&(i % 64)) && (20..44).contains(&(i / 64)) { 0.9 } else { 0.1 });
//! let image = Image::from(GrayImage::new(64, 64, samples.collect())?);
//! let features = Extractors::default().named("sift")?.extract(&image, 100)?;
//! assert!(!features.keypoints.is_empty());
//! assert_eq!(features.descriptors.row(0).len(), 128);
//!
//! let unknown = Extractors::default().named("orb").err().map(|e| e.to_string());
//! assert_eq!(unknown.as_deref(), Some("no extractor for features of kind orb; available: sift, compact"));
//! # Ok::<(), veiloc_features::FeatureError>(())
//! ```
#![forbid(unsafe_code)]

mod colour;
mod compact;
#[cfg(feature = "learned")]
pub mod detector;
mod error;
mod exif;
mod extract;
mod extractor;
mod extractors;
mod frame;
mod frame_mask;
mod global;
mod gray;
#[cfg(feature = "heic")]
mod heic;
mod input;
mod jpeg;
mod keypoint;
#[cfg(feature = "learned")]
pub mod learned;
mod load;
mod mask;
mod orientation;
mod panorama;
mod progress;
mod segmenter;
mod sift;

pub use colour::{ColourImage, load_colour};
pub use compact::{Compact, Projection, ProjectionError, compact};
pub use error::FeatureError;
pub use exif::{exif_camera, exif_camera_of, exif_turns_of, guessed_camera, guessed_camera_of};
pub use extract::{ExtractedImage, Limits, extract_image, extract_loaded};
pub use extractor::{Extractor, FeatureStore, Sift};
pub use extractors::Extractors;
pub use frame::{CameraFrame, PixelFormat};
pub use frame_mask::{FrameMask, MaskKind, MaskKindError};
pub use global::{GlobalExtractor, SharedGlobal};
pub use gray::GrayImage;
pub use input::Image;
pub use keypoint::{Features, Keypoint};
pub use load::{
    IMAGE_EXTENSIONS, IMAGE_FORMATS, MAX_PIXELS, image_size, is_image_file, load_gray,
    spelled_image_extensions,
};
pub use mask::{Mask, load_mask};
pub use orientation::{DisplayTurn, display_turn};
pub use panorama::{faces_of_file, faces_of_image, is_marked_panorama};
pub use progress::Progress;
pub use segmenter::{MAX_SEGMENTER_BYTES, PersonSegmenter};
pub use sift::{Border, SiftOptions, extract_sift};
