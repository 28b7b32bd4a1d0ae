//! From a picture to keypoints, descriptors and one global vector. Runs on the device, and when a map is built.
//!
//! Keypoints exist in this room as plain positions; the server's rooms do not depend on it.
#![forbid(unsafe_code)]

mod keypoint;

pub use keypoint::{Features, Keypoint};
