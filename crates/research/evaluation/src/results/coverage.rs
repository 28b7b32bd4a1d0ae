//! Coverage of covariances: normalized errors, and the share of truths within their confidence regions.

use std::collections::BTreeMap;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use crate::results::chi_squared;

/// Nominal probabilities of the evaluated regions, percent.
pub const REGIONS: [u32; 3] = [50, 90, 99];

/// Squared errors of a pose normalized by its covariance; infinite if the covariance is invalid, or without a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalizedError {
    /// Error of the whole pose: chi-squared with six degrees of freedom if the covariance is right.
    pub pose: f64,
    /// Error of the camera centre: three degrees of freedom.
    pub center: f64,
}

impl NormalizedError {
    /// Value of a query without a pose.
    pub const NOT_LOCALIZED: Self = Self { pose: f64::INFINITY, center: f64::INFINITY };

    /// Normalized error of an estimate with its covariance in the chart of [`CameraFromWorld::perturbed`].
    pub fn of(estimate: &CameraFromWorld, covariance: &[[f64; 6]; 6], truth: &CameraFromWorld) -> Self {
        Self {
            pose: normalized_error(estimate, covariance, truth),
            center: normalized_center_error(estimate, &estimate.center_covariance(covariance), truth),
        }
    }

    /// Probability of the smallest confidence region of the pose that contains the true pose, 0 to 1.
    pub fn pose_region(&self) -> f64 {
        chi_squared::cumulative(6, self.pose)
    }

    /// The same for the camera centre.
    pub fn center_region(&self) -> f64 {
        chi_squared::cumulative(3, self.center)
    }
}

/// Share of truths within each of [`REGIONS`], by its percentage, given the probability of each truth's smallest
/// region.
pub fn shares(regions: &[f64]) -> BTreeMap<String, f64> {
    REGIONS
        .iter()
        .map(|percent| {
            let inside = regions.iter().filter(|r| **r <= f64::from(*percent) / 100.0).count();
            (percent.to_string(), inside as f64 / regions.len().max(1) as f64)
        })
        .collect()
}

/// `dᵀ C⁻¹ d` of the truth from the estimate, six degrees of freedom; infinite for an invalid covariance.
fn normalized_error(estimate: &CameraFromWorld, covariance: &[[f64; 6]; 6], truth: &CameraFromWorld) -> f64 {
    let step = Vector6::from(estimate.step_to(truth));
    normalized(&Matrix6::from_fn(|i, j| covariance[i][j]), &step)
}

/// The same for the camera centre alone, three degrees of freedom, from its covariance in the world frame.
fn normalized_center_error(
    estimate: &CameraFromWorld,
    covariance: &[[f64; 3]; 3],
    truth: &CameraFromWorld,
) -> f64 {
    let step: Vector3<f64> = truth.center().coords - estimate.center().coords;
    normalized(&Matrix3::from_fn(|i, j| covariance[i][j]), &step)
}

fn normalized<const N: usize>(covariance: &SMatrix<f64, N, N>, step: &SVector<f64, N>) -> f64 {
    // C = L Lᵀ by hand: nalgebra's factorization requires bounds that a generic N does not have.
    let mut l = SMatrix::<f64, N, N>::zeros();
    let mut squared = 0.0;
    let mut whitened = SVector::<f64, N>::zeros();
    for i in 0..N {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| l[(i, k)] * l[(j, k)]).sum();
            let rest = covariance[(i, j)] - known;
            l[(i, j)] = if i == j { rest.sqrt() } else { rest / l[(j, j)] };
        }
        let known: f64 = (0..i).map(|k| l[(i, k)] * whitened[k]).sum();
        whitened[i] = (step[i] - known) / l[(i, i)];
        squared += whitened[i] * whitened[i];
    }
    let regular = (0..N).all(|i| l[(i, i)].is_finite() && l[(i, i)] > 0.0) && squared.is_finite();
    if regular { squared } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_synthetic::problems::{normal, random_pose};

    #[test]
    fn normalized_errors_equal_explicit_inverse() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let a = Matrix6::from_fn(|_, _| normal(&mut rng));
            let covariance = a * a.transpose() * 1e-6;
            let estimate = random_pose(&mut rng);
            let step = Vector6::from_fn(|_, _| 1e-3 * normal(&mut rng));
            let truth = estimate.perturbed(&step.into());
            let expected = (step.transpose() * covariance.try_inverse().expect("regular") * step)[0];
            let rows: [[f64; 6]; 6] = std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)]));
            let found = normalized_error(&estimate, &rows, &truth);
            assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
        }
        let identity = CameraFromWorld::identity();
        for bad in [0.0, f64::INFINITY, f64::NAN, -1.0] {
            let rows: [[f64; 3]; 3] =
                std::array::from_fn(|i| std::array::from_fn(|j| if i == j { bad } else { 0.0 }));
            assert_eq!(normalized_center_error(&identity, &rows, &identity), f64::INFINITY, "{bad}");
        }
    }

    /// Poses sampled from their covariance have the nominal coverage.
    #[test]
    fn right_covariances_have_nominal_coverage() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let sd = [0.01, 0.02, 0.005, 0.3, 0.1, 0.2];
        let covariance: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sd[i] * sd[i] } else { 0.0 }));
        let drawn: Vec<NormalizedError> = (0..4000)
            .map(|_| {
                let estimate = random_pose(&mut rng);
                let truth = estimate.perturbed(&sd.map(|s| s * normal(&mut rng)));
                NormalizedError::of(&estimate, &covariance, &truth)
            })
            .collect();
        let pose = shares(&drawn.iter().map(NormalizedError::pose_region).collect::<Vec<_>>());
        // The centre's covariance is to first order in the rotation, whose lever here is metres long.
        let center = shares(&drawn.iter().map(NormalizedError::center_region).collect::<Vec<_>>());
        for (percent, bound) in [("50", 0.5), ("90", 0.9), ("99", 0.99)] {
            assert!((pose[percent] - bound).abs() < 0.025, "{percent}: {}", pose[percent]);
            assert!((center[percent] - bound).abs() < 0.03, "{percent}: {}", center[percent]);
        }
        assert_eq!(shares(&[]).values().sum::<f64>(), 0.0);
        assert_eq!(NormalizedError::NOT_LOCALIZED.center_region(), 1.0);
    }
}
