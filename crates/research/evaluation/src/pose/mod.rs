//! The pose engine alone, measured: on matches that are already there, and against what no estimator can beat.
//!
//! - [`evaluate_poses`]: on problems that others made, by any [`Recipe`]; with [`Recipe::Floor`] from the truth.
//! - [`crb`]: errors over the Cramér–Rao bound, on synthetic scenes.
//! - [`pose_problem`]: a problem of a file, obfuscated, as the engine takes it.
//!
//! Its parts that other evaluations share: [`truly_right`], [`mean_down`], [`scores_or_default`].
#![forbid(unsafe_code)]

pub mod crb;
mod evaluate;
mod floor;
mod gravity;
mod recipe;
mod scores;

pub use evaluate::{PoseEvaluation, evaluate_poses, pose_problem};
pub use floor::{ORACLE_RADIUS_PX, truly_right};
pub use gravity::{GravityError, GravitySource, mean_down};
pub use recipe::{Recipe, RecipeError};
pub use scores::scores_or_default;
