//! From an image to keypoints, descriptors and one global vector. Runs on the device, and when a map is built.
//!
//! Keypoints exist in this room as plain positions; the server's rooms do not depend on it.
#![forbid(unsafe_code)]

mod error;
mod gray;
mod keypoint;
mod load;
mod progress;
mod sift;

pub use error::FeatureError;
pub use gray::GrayImage;
pub use keypoint::{Features, Keypoint};
pub use load::{MAX_PIXELS, load_gray};
pub use progress::Progress;
pub use sift::{SiftOptions, extract_sift};
