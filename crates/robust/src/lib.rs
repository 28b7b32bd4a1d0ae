//! Robust estimation: LO-RANSAC, scores, samplers, refinement and covariance.
//!
//! [`estimate_pose`] is the door. Inside, [`ransac`] holds the one search loop, generic over what it estimates.
//!
//! Results depend on the problem, the options and the generator handed in, on nothing else.
#![forbid(unsafe_code)]
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "comparisons are written so that NaN fails")]

mod error;
mod estimate;
mod kernel;
mod log;
mod matches;
mod minimal;
mod options;
pub mod prior;
mod problem;
mod radial;
pub mod ransac;
mod refine;
mod sampler;

pub use error::PoseError;
pub use estimate::estimate_pose;
pub use options::{AnchoredSolver, PoseOptions, ScoreKind, UnknownScore, UnknownSolver};
pub use problem::{Correspondences, PoseEstimate, PoseProblem};
