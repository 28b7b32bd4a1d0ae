//! Finds people and things in an image, so that they can be hidden before anything is sent.
//!
//! The detector is a file that the user brings: ONNX, as YOLO writes it from version 8 on, one image in and one table of
//! boxes with class scores out ([`Detector`] has the form). Nothing here knows what a detector has learned; what it does not
//! find is not hidden.
//!
//! - [`Detector`]: a file, and the boxes it finds.
//! - [`Hider`]: classes to hide, with a margin: from an image to its [`Mask`](crate::Mask).
#![forbid(unsafe_code)]

mod boxes;
mod classes;
mod detect;
mod hider;
mod letterbox;

pub use boxes::Detection;
pub use detect::Detector;
pub use hider::{Hidden, HideOptions, Hider};
