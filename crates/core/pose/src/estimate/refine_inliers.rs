//! The pose of correspondences that are known to be right: non-robust least squares from a start.

use veiloc_geometry::CameraFromWorld;

use crate::confidence::assess;
use crate::error::PoseError;
use crate::estimate::pose_estimate::PoseEstimate;
use crate::likelihood::{Loss, Matches, PoseProblem, inverse_or_infinite, linearize, refine};
use crate::options::PoseOptions;
use crate::rig::FINAL_STEPS;

/// Refines a pose on correspondences that are known to be right.
///
/// Minimises the squared pixel distance of the projections from points or lines over the chosen correspondences,
/// starting at `start`. From the true pose on the right matches this is a lower bound for the error of any estimator.
/// The covariance is the residuals' variance times `(JᵀJ)⁻¹`.
///
/// # Errors
/// [`PoseError`] for a problem that [`crate::estimate_pose`] would reject, a mask of another length, or not more
/// correspondences than a minimal sample.
pub fn refine_pose(
    problem: &PoseProblem,
    start: &CameraFromWorld,
    inliers: &[bool],
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    let chosen = active(problem, inliers)?;
    let required = problem.observations.sample_size() + 1;
    if chosen.len() < required {
        return Err(PoseError::TooFew { required, actual: chosen.len() });
    }
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let refined = refine(&matches, &chosen, Loss::Squared, start, FINAL_STEPS);
    let system = linearize(&matches, &chosen, Loss::Squared, &refined.pose);
    let freedom = (matches.residuals() * chosen.len()).saturating_sub(6).max(1);
    let variance = 2.0 * system.loss / freedom as f64;
    let noise_px = variance.sqrt().max(f64::MIN_POSITIVE);
    let covariance = inverse_or_infinite(&(system.hessian / variance));
    let likelihoods = matches.log_likelihood_ratios(&refined.pose, noise_px);
    Ok(PoseEstimate {
        cam_from_world: refined.pose,
        inliers: inliers.to_vec(),
        inlier_count: chosen.len(),
        inlier_keypoints: matches.keypoints_among(chosen.iter().copied()),
        hypotheses: 0,
        score: refined.loss,
        noise_px,
        principal_shift_px: [0.0; 2],
        camera_evidence: None,
        gravity_test: None,
        camera_covariance: [[0.0; 6]; 6],
        focal_scale: 1.0,
        free_direction: None,
        covariance,
        covariance_by_matches: covariance,
        confidence: assess(&matches, &refined.pose, &chosen, &likelihoods, &covariance, f64::INFINITY),
        rival: None,
        refined: true,
    })
}

/// Indices of a mask, which must have the problem's length.
pub(crate) fn active(problem: &PoseProblem, inliers: &[bool]) -> Result<Vec<usize>, PoseError> {
    let expected = problem.points.len();
    if inliers.len() != expected {
        return Err(PoseError::LengthMismatch { what: "inliers", expected, actual: inliers.len() });
    }
    Ok((0..expected).filter(|&i| inliers[i]).collect())
}
