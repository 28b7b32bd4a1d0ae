//! Internal: evaluation of localization on scenes with known poses.
//!
//! - [`evaluate_scene`]: the whole pipeline, from images to poses, on a scene with known poses, under any
//!   [`Condition`]: queries that are dark, blurred or occluded, a sparse map, a wrong camera, gravity, several images
//!   together, and out-of-map images, which must not be localized.
//! - [`drawn_queries`]: data for a report's drawings of single queries that no document holds.
//! - [`attack_evaluation`]: what an attacker recovers from sealed queries.
//! - [`make_problems`]: problems for the pose engine alone, which `veiloc_evaluation::pose` evaluates.
//!
//! Metrics, JSON documents and text tables are in `veiloc_evaluation::results`, HTML pages in [`report`].
#![forbid(unsafe_code)]

pub mod attack_evaluation;
mod error;
mod make_problems;
pub mod pipeline;
pub mod pose;
pub mod report;
pub mod results;
mod scene;

pub use error::EvalError;
pub use make_problems::{GeneratedProblem, make_problems};
pub use scene::{
    CameraError, Condition, ConditionError, Degradation, DrawnQuery, DrawnScheme, FROM_TRUTH, NegativeImage,
    Odometry, RetrievedImages, SceneEvaluation, drawn_queries, evaluate_scene, folder_name, sequence_of,
};
