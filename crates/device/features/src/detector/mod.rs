//! Detects people and objects in an image, so that they can be hidden before anything is sent.
//!
//! The user provides the detector as a file: MediaPipe's selfie segmentation, a network for
//! [`PersonSegmenter`](crate::PersonSegmenter); or ONNX, as YOLO exports it from version 8 on, with one image as input and one
//! table of boxes with class scores as output ([`Detector`] has the format). What the detector does not detect is not hidden.
//!
//! - [`Detector`]: a file, and its detections.
//! - [`ObjectMasker`]: classes to hide, with a margin: from an image to its [`Mask`](crate::Mask).
#![forbid(unsafe_code)]

mod boxes;
mod classes;
mod detect;
mod letterbox;
mod object_masker;

pub use boxes::Detection;
pub use detect::Detector;
pub use object_masker::{Hidden, HideOptions, ObjectMasker};
