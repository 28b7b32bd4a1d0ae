//! How well correspondences determine a pose: Fisher information.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix6, SMatrix};

use crate::error::PoseError;
use crate::matches::Matches;
use crate::problem::PoseProblem;
use crate::refine::{Loss, linearize};

/// Matches with a log likelihood ratio below this weigh nothing.
pub(crate) const NEGLIGIBLE: f64 = -14.0;

/// A symmetric matrix over the six numbers of [`CameraFromWorld::perturbed`].
pub(crate) type Symmetric6 = [[f64; 6]; 6];

/// Fisher information of the pose in the chosen correspondences: `JᵀJ / σ²`, in the chart of
/// [`CameraFromWorld::perturbed`] (radians, then map units) at `pose`.
///
/// `σ = noise_px` is the standard deviation of a keypoint along each axis (for lines: across the line). The inverse is
/// the Cramér–Rao bound: no unbiased estimator has a smaller covariance, whatever it does about the other matches.
/// Correspondences behind the camera bring nothing.
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
    let system = linearize(&matches, &active, Loss::Squared, pose);
    Ok(symmetric(&(system.hessian / (noise_px * noise_px))))
}

/// Indices of a mask that must fit the problem.
pub(crate) fn active(problem: &PoseProblem, inliers: &[bool]) -> Result<Vec<usize>, PoseError> {
    let expected = problem.points.len();
    if inliers.len() != expected {
        return Err(PoseError::LengthMismatch { what: "inliers", expected, actual: inliers.len() });
    }
    Ok((0..expected).filter(|&i| inliers[i]).collect())
}

pub(crate) fn symmetric(m: &Matrix6<f64>) -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[(i, j)] + m[(j, i)])))
}

/// Inverse of an information matrix; infinite on the diagonal when a direction is left free.
pub(crate) fn inverse_or_infinite(information: &Matrix6<f64>) -> Symmetric6 {
    // Radians and map units differ in scale: compare directions only after giving each unit information.
    let scale = information.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    let scaled = Matrix6::from_diagonal(&scale) * information * Matrix6::from_diagonal(&scale);
    let inverse = scaled
        .cholesky()
        .map(|factor| Matrix6::from_diagonal(&scale) * factor.inverse() * Matrix6::from_diagonal(&scale))
        .filter(|c: &SMatrix<f64, 6, 6>| scale.min() > 0.0 && c.iter().all(|x| x.is_finite()));
    match inverse {
        Some(c) => symmetric(&c),
        None => infinite(),
    }
}

/// The covariance of what nothing is known of.
pub(crate) fn infinite() -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { f64::INFINITY } else { 0.0 }))
}
