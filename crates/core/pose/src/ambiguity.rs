//! Poses that were met on the way and explain the matches too: by how much the best of them is beaten.

use crate::likelihood::Symmetric6;
use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix6, Vector6};

/// Squared Mahalanobis distance from which on another pose is another answer, not the same one found again.
const ELSEWHERE: f64 = 400.0;

/// By how much a pose that costs `own` beats the best of the optima that lies elsewhere, by its covariance in the chart of
/// [`Rigid3::perturbed`]; infinite when none does.
///
/// Optima were met in passing: their descent ended early, at the noise that was assumed. Matches that show a smaller one have
/// a covariance by which a pose in the same valley lies far away and yet costs hardly more. So whatever comes closer than
/// `least` is refined to its end first (`refined`), and is the same answer where that leads to the pose.
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
    let elsewhere = |other: &Rigid3<Frame, World>| {
        let step = Vector6::from(pose.step_to(other));
        !(step.dot(&factor.solve(&step)) < ELSEWHERE)
    };
    optima
        .iter()
        .filter(|(other, _)| elsewhere(other))
        .map(|(other, cost)| (other, (cost - own).max(0.0)))
        .filter(|(other, margin)| *margin >= least || elsewhere(&refined(other)))
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

    /// Standard deviations of a hundredth.
    fn covariance() -> Symmetric6 {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1e-4 } else { 0.0 }))
    }

    fn margin_of(optima: &[(f64, f64)], leads_to: impl Fn(f64) -> f64) -> f64 {
        let optima: Vec<_> = optima.iter().map(|(x, cost)| (at(*x), *cost)).collect();
        let refined = |other: &Rigid3<Camera, World>| at(leads_to(other.translation().x));
        margin(&optima, &at(0.0), -100.0, &covariance(), 8.0, refined)
    }

    #[test]
    fn a_pose_on_its_way_to_the_answer_is_no_rival() {
        let valley = [(0.3, -97.0), (0.5, -95.0), (3.0, -60.0)];
        assert_eq!(margin_of(&valley, |x| if x < 1.0 { 0.001 } else { x }), 40.0);
    }

    #[test]
    fn a_pose_that_stays_elsewhere_is_one_however_near_it_lies() {
        assert_eq!(margin_of(&[(0.3, -97.0), (3.0, -60.0)], |x| x), 3.0);
        // One that is far behind is told as it was met.
        assert_eq!(margin_of(&[(3.0, -60.0)], |_| 0.0), 40.0);
        assert_eq!(margin_of(&[(0.1, -99.0)], |x| x), f64::INFINITY);
    }
}
