//! Data sets, metrics, tables and reports: how well it localizes, and what it leaks.
#![forbid(unsafe_code)]

pub mod demo;
mod error;
mod json_lines;
pub mod metrics;
mod poses;
pub mod problems;
pub mod report;
pub mod results;
mod scene;
mod seeds;

pub use error::EvalError;
pub use poses::{PoseEvaluation, evaluate_poses};
pub use scene::{SceneEvaluation, evaluate_scene};
