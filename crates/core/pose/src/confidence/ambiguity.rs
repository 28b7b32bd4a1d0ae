//! Ambiguity: the margin by which a pose beats the best other optimum of the search.

use crate::likelihood::Symmetric6;
use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix6, Vector6};

/// Squared Mahalanobis distance beyond which another pose is a different answer, not the same optimum again.
const DISTINCT_MAHALANOBIS_SQUARED: f64 = 400.0;

/// Difference between `own`, the cost of `pose`, and the cost of the best optimum at another pose, by the pose's
/// covariance in the chart of [`Rigid3::perturbed`]; infinite when there is none.
///
/// The optima were recorded during the search: their descent ended early, at the assumed noise. If the matches have
/// less noise, the covariance is small, and a pose in the same valley is far away by it although its cost is hardly
/// higher. So every optimum whose margin is below `least` is first refined to convergence (`refined`); if it converges
/// to the pose, it is the same answer.
pub(crate) fn margin<Frame>(
    optima: &[(Rigid3<Frame, World>, f64)],
    pose: &Rigid3<Frame, World>,
    own: f64,
    covariance: &Symmetric6,
    least: f64,
    refined: impl Fn(&Rigid3<Frame, World>) -> Rigid3<Frame, World>,
) -> f64 {
    let covariance = Matrix6::from_fn(|i, j| covariance[i][j]);
    let Some(factor) = covariance.iter().all(|c| c.is_finite()).then(|| covariance.cholesky()).flatten()
    else {
        return f64::INFINITY;
    };
    let is_distinct = |other: &Rigid3<Frame, World>| {
        let step = Vector6::from(pose.step_to(other));
        !(step.dot(&factor.solve(&step)) < DISTINCT_MAHALANOBIS_SQUARED)
    };
    optima
        .iter()
        .filter(|(other, _)| is_distinct(other))
        .map(|(other, cost)| (other, (cost - own).max(0.0)))
        .filter(|(other, margin)| *margin >= least || is_distinct(&refined(other)))
        .map(|(_, margin)| margin)
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::CameraFromWorld;
    use veiloc_geometry::frames::Camera;
    use veiloc_geometry::nalgebra::{Rotation3, Vector3};

    fn at(x: f64) -> Rigid3<Camera, World> {
        CameraFromWorld::new(Rotation3::identity(), Vector3::new(x, 0.0, 0.0))
    }

    /// Standard deviations of 0.01.
    fn covariance() -> Symmetric6 {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1e-4 } else { 0.0 }))
    }

    fn margin_of(optima: &[(f64, f64)], leads_to: impl Fn(f64) -> f64) -> f64 {
        let optima: Vec<_> = optima.iter().map(|(x, cost)| (at(*x), *cost)).collect();
        let refined = |other: &Rigid3<Camera, World>| at(leads_to(other.translation().x));
        margin(&optima, &at(0.0), -100.0, &covariance(), 8.0, refined)
    }

    #[test]
    fn optimum_that_converges_to_the_pose_is_ignored() {
        let valley = [(0.3, -97.0), (0.5, -95.0), (3.0, -60.0)];
        assert_eq!(margin_of(&valley, |x| if x < 1.0 { 0.001 } else { x }), 40.0);
    }

    #[test]
    fn converged_distinct_optimum_limits_the_margin() {
        assert_eq!(margin_of(&[(0.3, -97.0), (3.0, -60.0)], |x| x), 3.0);
        // An optimum with a large margin keeps its recorded cost.
        assert_eq!(margin_of(&[(3.0, -60.0)], |_| 0.0), 40.0);
        assert_eq!(margin_of(&[(0.1, -99.0)], |x| x), f64::INFINITY);
    }
}
