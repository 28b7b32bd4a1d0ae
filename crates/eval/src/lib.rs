//! Data sets, metrics, tables and reports: how well it localizes, and what it leaks.
#![forbid(unsafe_code)]

pub mod audit;
mod chi_squared;
pub mod crb;
pub mod demo;
mod error;
mod hypotheses;
mod json_lines;
mod make_problems;
pub mod metrics;
mod negatives;
mod plotting;
mod poses;
pub mod problems;
pub mod report;
pub mod results;
mod scene;
mod seeds;
mod text_table;
pub mod tradeoff;

pub use error::EvalError;
pub use hypotheses::{Hypotheses, HypothesesError};
pub use make_problems::{MadeProblem, ProblemSource, encode_lines, make_problems};
pub use negatives::Negatives;
pub use poses::{GravityError, GravitySource, PoseEvaluation, Recipe, RecipeError, evaluate_poses};
pub use scene::{SceneEvaluation, evaluate_scene};
