//! Poses that were met on the way and explain the matches too: by how much the best of them is beaten.

use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix6, Vector6};
use veiloc_likelihood::Symmetric6;

/// Squared Mahalanobis distance from which on another pose is another answer, not the same one found again.
const ELSEWHERE: f64 = 400.0;

/// By how much a pose that costs `own` beats the best of the optima that lies elsewhere, by its covariance in the chart of
/// [`Rigid3::perturbed`]; infinite when none does.
pub(crate) fn margin<Frame>(
    optima: &[(Rigid3<Frame, World>, f64)],
    pose: &Rigid3<Frame, World>,
    own: f64,
    covariance: &Symmetric6,
) -> f64 {
    let covariance = Matrix6::from_fn(|i, j| covariance[i][j]);
    let Some(factor) = covariance.iter().all(|c| c.is_finite()).then(|| covariance.cholesky()).flatten()
    else {
        return f64::INFINITY;
    };
    let elsewhere = |other: &Rigid3<Frame, World>| {
        let step = Vector6::from(pose.step_to(other));
        !(step.dot(&factor.solve(&step)) < ELSEWHERE)
    };
    optima
        .iter()
        .filter(|(other, _)| elsewhere(other))
        .map(|(_, cost)| (cost - own).max(0.0))
        .fold(f64::INFINITY, f64::min)
}
