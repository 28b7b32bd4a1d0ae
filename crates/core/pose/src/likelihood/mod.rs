//! What a camera pose costs: correspondences, their likelihood and its derivatives, covariance.
//!
//! This module looks at one pose at a time and searches for none; `veiloc-pose` does. A [`PoseProblem`] is what is known,
//! [`Matches`] are its correspondences with what each is worth (the likelihood is stated there), [`Kernel`] is the fast sum
//! over all of them, [`refine`] and [`descend`] go downhill from a start, [`ZoomObjective`] does so with the focal length as
//! a seventh number, and [`Estimated`] says how firmly the end is held.
//!
//! Units: pixels in the image (COLMAP's convention), map units in the world; a step of a pose is that of
//! [`veiloc_geometry::CameraFromWorld::perturbed`], radians before map units. A likelihood is a natural logarithm.
//!
//! Nothing is drawn at random here: equal input gives equal results.
#![forbid(unsafe_code)]

mod by_anchor;
mod covariance;
mod descent;
mod fisher;
mod focal;
mod kernel;
mod matches;
mod outlier_density;
mod pose_priors;
pub mod prior;
mod problem;
mod refine;
#[cfg(test)]
mod test_data;
mod visibility;

pub use covariance::{Estimated, free_along, with_shift};
pub use descent::{Convergence, Descended, levenberg_marquardt};
pub use fisher::{NEGLIGIBLE, Symmetric6, inverse_or_infinite};
pub use focal::{FocalVerdict, ZoomObjective, ZoomSystem, Zoomed, stretched};
pub use kernel::{Kernel, Scale, log_farthest, median_point, promising_first};
pub use matches::Matches;
pub use pose_priors::PosePriors;
pub use problem::{Correspondences, FocalKnowledge, Gravity, PoseProblem, PositionPrior, SeenFrom};
pub use refine::{Loss, Refined, System, descend, linearize, refine};
