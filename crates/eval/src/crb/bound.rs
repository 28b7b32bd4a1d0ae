//! What the Cramér–Rao bound predicts: errors of an estimator whose covariance is the inverse Fisher information.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use veiloc_synth::problems::normal;

use crate::metrics::PoseError;

/// Errors of `draws` poses from the normal distribution around the truth with this Fisher information, in the chart of
/// [`CameraFromWorld::perturbed`]; `None` when the information leaves a direction free.
pub(crate) fn predicted_errors<R: Rng>(
    truth: &CameraFromWorld,
    information: &[[f64; 6]; 6],
    draws: usize,
    rng: &mut R,
) -> Option<Vec<PoseError>> {
    let information = Matrix6::from_fn(|i, j| information[i][j]);
    // F = L Lᵀ, so L⁻ᵀ z has covariance F⁻¹.
    let upper = information.cholesky()?.l().transpose();
    (0..draws)
        .map(|_| {
            let step = upper.solve_upper_triangular(&Vector6::from_fn(|_, _| normal(rng)))?;
            Some(PoseError::of(&truth.perturbed(&step.into()), truth))
        })
        .collect()
}

/// The step from one pose to another in the chart of [`CameraFromWorld::perturbed`]: `from.perturbed(&step)` is `to`.
pub(crate) fn step_between(from: &CameraFromWorld, to: &CameraFromWorld) -> [f64; 6] {
    let turn = to.rotation() * from.rotation().inverse();
    let w = turn.scaled_axis();
    let v = to.translation() - turn * from.translation();
    [w.x, w.y, w.z, v.x, v.y, v.z]
}

/// `dᵀ C⁻¹ d` of the truth from the estimate, six degrees of freedom; infinite when the covariance is no covariance.
pub(crate) fn normalized_error(
    estimate: &CameraFromWorld,
    covariance: &[[f64; 6]; 6],
    truth: &CameraFromWorld,
) -> f64 {
    let step = Vector6::from(step_between(estimate, truth));
    normalized(&Matrix6::from_fn(|i, j| covariance[i][j]), &step)
}

/// The same of the camera centre alone, three degrees of freedom, from its covariance in the world frame.
pub(crate) fn normalized_center_error(
    estimate: &CameraFromWorld,
    covariance: &[[f64; 3]; 3],
    truth: &CameraFromWorld,
) -> f64 {
    let step: Vector3<f64> = truth.center().coords - estimate.center().coords;
    normalized(&Matrix3::from_fn(|i, j| covariance[i][j]), &step)
}

fn normalized<const N: usize>(covariance: &SMatrix<f64, N, N>, step: &SVector<f64, N>) -> f64 {
    // C = L Lᵀ by hand: nalgebra's factorization wants bounds that a generic N does not have.
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
    use crate::chi_squared::cumulative;
    use crate::metrics::median;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_synth::problems::random_pose;

    #[test]
    fn the_step_between_two_poses_leads_from_one_to_the_other() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..100 {
            let (from, to) = (random_pose(&mut rng), random_pose(&mut rng));
            let there = from.perturbed(&step_between(&from, &to));
            assert!(there.rotation_error_degrees(&to) < 1e-5 && there.translation_error(&to) < 1e-9);
        }
    }

    #[test]
    fn normalized_errors_agree_with_the_inverse() {
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

    /// Draws cover as often as they should, and the median error of one coordinate is the normal's: 0.6745 σ.
    #[test]
    fn predicted_errors_have_the_covariance_of_the_bound() {
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
