//! Evaluation of the pose engine alone, on given matches.
//!
//! - [`evaluate_poses`]: on given problems, by any [`Recipe`]; with [`Recipe::Floor`] from the truth.
//! - [`pose_problem`]: a problem of a file, obfuscated, as input of the engine.
//!
//! Shared with other evaluations: [`true_matches`], [`mean_down`], [`scores_or_default`].
#![forbid(unsafe_code)]

mod evaluate;
mod floor;
mod gravity;
mod recipe;
mod scores;

pub use evaluate::{PoseEvaluation, evaluate_poses, pose_problem};
pub use floor::{ORACLE_RADIUS_PX, true_matches};
pub use gravity::{GravityError, GravitySource, mean_down};
pub use recipe::{Recipe, RecipeError};
pub use scores::scores_or_default;
