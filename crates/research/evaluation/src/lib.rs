//! Internal: evaluation of localization: scenes with known poses, and negative queries.
//!
//! - [`evaluate_scene`]: the whole pipeline, from images to poses, on a scene with known poses (with
//!   [`NegativeQueryImages`]: also on queries of another scene).
//! - [`drawn_queries`]: data for a report's drawings of single queries that no document holds.
//! - [`stress`]: the same scene with queries that are dark, blurred, occluded or small, with few keypoints, or a
//!   sparse map.
//! - [`negatives`]: out-of-map images, which must not be localized.
//! - [`evaluate_rig`]: the same for sequences of images with simulated odometry.
//! - [`make_problems`]: problems for the pose engine alone, which `veiloc_evaluation::pose` evaluates.
//!
//! Metrics, JSON documents and text tables are in `veiloc_evaluation::results`.
#![forbid(unsafe_code)]

pub mod audit;
mod error;
pub mod inversion;
mod make_problems;
pub mod negatives;
pub mod pipeline;
pub mod pose;
pub mod privacy;
pub mod results;
mod rig;
mod scene;
pub mod stress;

pub use error::EvalError;
pub use make_problems::{GeneratedProblem, make_problems};
pub use rig::{RigEvaluation, evaluate_rig, sequence_of};
pub use scene::{
    DrawnQuery, DrawnScheme, NegativeQueryImages, SceneEvaluation, drawn_queries, evaluate_scene, folder_name,
};
