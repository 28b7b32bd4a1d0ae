//! Files that evaluations and attacks exchange: correspondence problems, keypoints of images, lists of images.
//!
//! - [`problems`]: `problems.jsonl`, 2D–3D matches with the true pose, the input of `veiloc eval pose`.
//! - [`keypoints`]: `keypoints.jsonl`, keypoints with or without descriptors, the input of `veiloc attack`.
//! - [`images`]: images of folders, and their keypoints as a device would extract them.
//! - [`json_lines`]: the file format, plain or gzipped, one JSON object per line.
//! - [`is_in_design_split`]: the split of a set of images into two halves, by their names.
//! - [`seed_for`]: one seed for each named part of a run, independent of the other parts.
#![forbid(unsafe_code)]

pub mod images;
pub mod json_lines;
pub mod keypoints;
pub mod problems;
mod seeds;
mod split;

pub use images::{keypoints_of_image, keypoints_of_images};
pub use keypoints::{KeypointImage, encode_keypoints, read_keypoints, synthetic_image};
pub use problems::{Problem, ProblemLine, read_problems};
pub use seeds::seed_for;
pub use split::is_in_design_split;
