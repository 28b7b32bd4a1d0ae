//! The cost of a camera pose: correspondences, their likelihood and its derivatives, covariance.
//!
//! This module evaluates and refines single poses; the search is in [`crate::ransac`]. A [`PoseProblem`] is the input,
//! [`Matches`] are its correspondences with their likelihood (defined there), [`Kernel`] is the fast sum over all of
//! them, [`refine`] and [`descend`] minimise from a start, [`Objective`] includes the focal length as a seventh
//! parameter, and [`CovarianceInputs`] gives the covariance of the result.
//!
//! Units: pixels in the image (COLMAP's convention), map units in the world; a step of a pose is that of
//! [`veiloc_geometry::CameraFromWorld::perturbed`], radians before map units. A likelihood is a natural logarithm.
//!
//! Nothing here is random: equal input gives equal results.
#![forbid(unsafe_code)]

mod by_anchor;
mod camera;
mod camera_error;
mod covariance;
mod descent;
mod design_effect;
pub(crate) mod duplicates;
mod fisher;
mod focal;
mod gravity_test;
mod kernel;
mod map_cameras;
mod matches;
mod objective;
mod outlier_density;
mod pose_priors;
mod problem;
mod refine;
mod system;
#[cfg(test)]
mod test_data;
mod visibility;

pub use camera::{CameraChange, PoseWithCamera};
pub use camera_error::{CameraInfluence, CameraLinearization, CameraObjective, CameraVerdict, FocalTest};
pub use covariance::{CovarianceInputs, free_along, with_shift};
pub use descent::{Convergence, DescentResult, levenberg_marquardt};
pub use design_effect::ScoreCells;
pub use fisher::{MIN_LOG_LIKELIHOOD_RATIO, Symmetric6, inverse_or_infinite};
pub(crate) use fisher::{infinite, propagated, sum};
pub use focal::FocalVerdict;
pub use gravity_test::{GravityAgreement, GravityTest};
pub use kernel::{Kernel, Scale, log_farthest, median_point, promising_first};
pub use map_cameras::{BestCamera, CameraEvidence, MapCameras};
pub use matches::Matches;
pub use objective::{Objective, Scores};
pub use pose_priors::PosePriors;
pub use problem::{Correspondences, FocalPrior, Gravity, MatchViewpoint, PoseProblem, PositionPrior};
pub use refine::{Loss, Refined, descend, linearize, refine};
pub(crate) use system::damped;
pub use system::{POSE, POSE_AND_CAMERA, POSE_AND_FOCAL, System};
