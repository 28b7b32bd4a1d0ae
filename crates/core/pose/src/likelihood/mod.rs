//! The cost of a camera pose: correspondences, their likelihood and its derivatives, covariance.
//!
//! This module evaluates and refines single poses; the search is in [`crate::ransac`]. A [`PoseProblem`] is the input,
//! [`Matches`] are its correspondences with their likelihood (defined there), [`Kernel`] is the fast sum over all of
//! them, [`refine`] and [`descend`] minimise from a start, [`FocalObjective`] includes the focal length as a seventh
//! parameter, and [`CovarianceInputs`] gives the covariance of the result.
//!
//! Units: pixels in the image (COLMAP's convention), map units in the world; a step of a pose is that of
//! [`veiloc_geometry::CameraFromWorld::perturbed`], radians before map units. A likelihood is a natural logarithm.
//!
//! Nothing here is random: equal input gives equal results.
#![forbid(unsafe_code)]

mod by_anchor;
mod camera_error;
mod covariance;
mod descent;
mod design_effect;
mod fisher;
mod focal;
mod gravity_test;
mod kernel;
mod map_cameras;
mod matches;
mod outlier_density;
mod pose_priors;
pub mod prior;
mod problem;
mod refine;
#[cfg(test)]
mod test_data;
mod visibility;

pub use camera_error::{
    CameraChange, CameraInfluence, CameraLook, CameraObjective, CameraVerdict, FocalTest, PoseWithCamera,
};
pub use covariance::{CovarianceInputs, free_along, with_shift};
pub use descent::{Convergence, DescentResult, levenberg_marquardt};
pub use design_effect::ScoreCells;
pub use fisher::{MIN_LOG_LIKELIHOOD_RATIO, Symmetric6, inverse_or_infinite};
pub(crate) use fisher::{propagated, sum};
pub use focal::{FocalObjective, FocalSystem, FocalVerdict, PoseWithFocal, step_focal};
pub use gravity_test::{GravityAgreement, GravityTest};
pub use kernel::{Kernel, Scale, log_farthest, median_point, promising_first};
pub use map_cameras::{BestCamera, CameraEvidence, MapCameras};
pub use matches::Matches;
pub use pose_priors::PosePriors;
pub use problem::{Correspondences, FocalPrior, Gravity, MatchViewpoint, PoseProblem, PositionPrior};
pub use refine::{Loss, Refined, System, descend, linearize, refine};
