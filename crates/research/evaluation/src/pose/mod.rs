//! Evaluation of the pose engine alone, on given matches.
//!
//! - [`evaluate_poses`]: on given problems, by any [`Estimator`]; with `optimum` and `floor` from the truth.
//! - [`pose_problem`]: a problem of a file, obfuscated, as input of the engine.
//!
//! Shared with other evaluations: [`true_matches`], [`mean_down`].
#![forbid(unsafe_code)]

mod estimator;
mod evaluate;
mod floor;
mod gravity;

pub use estimator::Estimator;
pub(crate) use estimator::common_hypotheses;
pub use evaluate::{PoseEvaluation, evaluate_poses, pose_problem};
pub use floor::{ORACLE_RADIUS_PX, true_matches};
pub use gravity::{GravityError, GravitySource, mean_down};
