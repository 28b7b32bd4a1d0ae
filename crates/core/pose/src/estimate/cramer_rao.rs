//! How well correspondences determine a pose: Fisher information, whose inverse bounds every covariance from below.

use crate::likelihood::{Loss, Matches, PoseProblem, linearize};
use veiloc_geometry::CameraFromWorld;

use crate::error::PoseError;
use crate::estimate::refine_inliers::active;

/// Fisher information of the pose in the chosen correspondences: `JᵀJ / σ²`, in the chart of
/// [`CameraFromWorld::perturbed`] (radians, then map units) at `pose`.
///
/// `σ = noise_px` is the standard deviation of a keypoint along each axis (for lines: across the line). The inverse is
/// the Cramér–Rao bound: no unbiased estimator has a smaller covariance, whatever it does about the other matches.
/// Correspondences behind the camera contribute nothing.
///
/// # Errors
/// [`PoseError`] for a problem that [`crate::estimate_pose`] would refuse, a mask of another length, or a noise that is
/// not positive.
pub fn fisher_information(
    problem: &PoseProblem,
    pose: &CameraFromWorld,
    inliers: &[bool],
    noise_px: f64,
) -> Result<[[f64; 6]; 6], PoseError> {
    problem.check()?;
    if !(noise_px.is_finite() && noise_px > 0.0) {
        return Err(PoseError::BadValue { what: "noise_px", value: noise_px });
    }
    let active = active(problem, inliers)?;
    let matches = Matches::new(problem, 0.5);
    let information = linearize(&matches, &active, Loss::Squared, pose).hessian / (noise_px * noise_px);
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| information[(i, j)])))
}
