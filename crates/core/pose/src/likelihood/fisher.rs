//! Information about a pose and its inverse, a covariance, in which a direction may be free.

use veiloc_geometry::nalgebra::{Matrix6, SMatrix};

/// Matches with a log likelihood ratio below this, a natural logarithm, have no weight.
pub const MIN_LOG_LIKELIHOOD_RATIO: f64 = -14.0;

/// A symmetric matrix over the six parameters of [`veiloc_geometry::CameraFromWorld::perturbed`]:
/// radians, then map units.
pub type Symmetric6 = [[f64; 6]; 6];

fn symmetric(m: &Matrix6<f64>) -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[(i, j)] + m[(j, i)])))
}

/// `J C Jᵀ`: the covariance `C` of parameters, propagated to a pose that moves by `J` with them; `None` when it is not
/// finite.
pub(crate) fn propagated(jacobian: &Matrix6<f64>, covariance: &Matrix6<f64>) -> Option<Symmetric6> {
    let propagated = jacobian * covariance * jacobian.transpose();
    propagated.iter().all(|c| c.is_finite()).then(|| symmetric(&propagated))
}

/// The covariance of a sum of independent errors.
pub(crate) fn sum(a: &Symmetric6, b: &Symmetric6) -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]))
}

/// Inverse of an information matrix; infinite on the diagonal when a direction is free.
pub fn inverse_or_infinite(information: &Matrix6<f64>) -> Symmetric6 {
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

/// The covariance of an unknown pose.
pub(crate) fn infinite() -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { f64::INFINITY } else { 0.0 }))
}
