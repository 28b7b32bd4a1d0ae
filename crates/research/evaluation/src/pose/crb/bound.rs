//! Prediction of the Cramér–Rao bound: errors of an estimator whose covariance is the inverse Fisher information.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix6, Vector6};
use veiloc_synthetic::problems::normal;

use crate::results::metrics::PoseErrors;

/// Errors of `draws` poses from the normal distribution around the truth with this Fisher information, in the chart
/// of [`CameraFromWorld::perturbed`]; `None` when the information is singular.
pub(crate) fn predicted_errors<R: Rng>(
    truth: &CameraFromWorld,
    information: &[[f64; 6]; 6],
    draws: usize,
    rng: &mut R,
) -> Option<Vec<PoseErrors>> {
    let information = Matrix6::from_fn(|i, j| information[i][j]);
    // F = L Lᵀ, so L⁻ᵀ z has covariance F⁻¹.
    let upper = information.cholesky()?.l().transpose();
    (0..draws)
        .map(|_| {
            let step = upper.solve_upper_triangular(&Vector6::from_fn(|_, _| normal(rng)))?;
            Some(PoseErrors::of(&truth.perturbed(&step.into()), truth))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::chi_squared::cumulative;
    use crate::results::metrics::median;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_synthetic::problems::random_pose;

    /// Samples have the right coverage, and the median error of one coordinate is that of the normal: 0.6745 σ.
    #[test]
    fn predicted_errors_have_covariance_of_bound() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let truth = random_pose(&mut rng);
        let mut information = [[0.0; 6]; 6];
        for (i, row) in information.iter_mut().enumerate() {
            // Only one rotation axis and one translation axis move.
            row[i] = if i == 2 || i == 3 { 1e6 } else { 1e14 };
        }
        let errors = predicted_errors(&truth, &information, 4000, &mut rng).expect("regular");
        let translations: Vec<f64> = errors.iter().map(|e| e.translation).collect();
        let rotations: Vec<f64> = errors.iter().map(|e| e.rotation_deg.to_radians()).collect();
        for found in [median(&translations), median(&rotations)] {
            assert!((found / 0.6745e-3 - 1.0).abs() < 0.05, "{found}");
        }
        // One degree of freedom within 0.6745 σ: half.
        assert!((cumulative(1, 0.6745 * 0.6745) - 0.5).abs() < 1e-4);
        assert!(predicted_errors(&truth, &[[0.0; 6]; 6], 3, &mut rng).is_none());
    }
}
