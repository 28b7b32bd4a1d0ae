//! How well it localizes: places with known poses, and negative queries.
//!
//! - [`evaluate_scene`]: the whole road, from images to poses, on a place with known poses ([`Negatives`]: and on queries
//!   of another place).
//! - [`drawn_queries`]: what a report draws of single queries and no document holds.
//! - [`stress`]: the same place with queries in the dark, moved, half hidden, small, few keypoints, or a sparse map.
//! - [`negatives`]: images of elsewhere, which must not be found in a map.
//! - [`evaluate_rig`]: the same for sessions of several images with simulated odometry.
//! - [`make_problems`]: problems for the pose engine alone, which `veiloc_evaluation::pose` measures.
//!
//! What is counted, the JSON documents and the tables for people are in `veiloc_evaluation::results`.
#![forbid(unsafe_code)]

pub mod audit;
mod error;
pub mod inversion;
mod make_problems;
pub mod negatives;
pub mod pose;
pub mod privacy;
pub mod results;
pub mod retrieval;
mod rig;
pub mod road;
mod scene;
pub mod stress;

pub use error::EvalError;
pub use make_problems::{MadeProblem, ProblemSource, make_problems, masks_of};
pub use rig::{RigEvaluation, evaluate_rig, walk_of};
pub use scene::{
    DrawnQuery, DrawnScheme, Negatives, SceneEvaluation, drawn_queries, evaluate_scene, folder_name,
};
