//! The covariance of an estimate, with all parts of its error.
//!
//! The sandwich covariance of an M-estimator (Huber and Ronchetti, *Robust Statistics*, 2009, eq. 7.43): with `r` the
//! probability that a match is right, `Ψ = r · 6 e / (ν σ² + e²)` its score and `Ψ′` the derivative, in which a match
//! with a large residual loses its weight,
//!
//! ```text
//! V = K² · n/(n − p) · (Σ Ψ² / n) / (Σ Ψ′ / n)²      K = 1 + p/n · Var Ψ′ / (E Ψ′)²
//! C = H⁻¹ (Σ r f JᵀJ / V + P) H⁻¹                    H = Σ r JᵀJ / V + P
//! ```
//!
//! with `n = Σ r` and `p = 6` over the residuals of a match. It uses the observed residuals, not those that the model
//! predicts, so it stays valid when they are not Student-distributed. Further:
//!
//! - **a keypoint counts once**, however many map points it was matched to, and so does a map point: their matches
//!   share one error, so each gets a share of `r`;
//! - **the map's own error** is included: `f` is a match's variance divided by the mean variance, from the covariance
//!   of its map point projected into the image;
//! - `P` is the information of the camera priors ([`PosePriors`]);
//! - **errors that neighbouring matches share** multiply the first term between the inverses by their design effect;
//! - an estimated focal length is a seventh parameter, and its uncertainty is included in `C`.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3};

use crate::likelihood::fisher::{MIN_LOG_LIKELIHOOD_RATIO, Symmetric6, infinite};
use crate::likelihood::matches::{Matches, Residual};
use crate::likelihood::pose_priors::PosePriors;

type Matrix7 = SMatrix<f64, 7, 7>;

/// Minimum of a match's variance relative to the mean: the map's covariances show which points are worse, not that a
/// point is perfect. The maximum is the square of the largest score, which is bounded: a match whose map point is off
/// by much more than the noise loses its weight instead of moving the pose.
const MIN_VARIANCE_SHARE: f64 = 0.2;

/// The inputs of a pose covariance.
pub struct CovarianceInputs<'a> {
    /// The correspondences that the pose can see.
    pub matches: &'a Matches<'a>,
    /// The camera priors.
    pub priors: &'a PosePriors,
    /// The pose.
    pub pose: &'a CameraFromWorld,
    /// Log likelihood ratios at the pose, `[N]`.
    pub likelihoods: &'a [f64],
    /// Scale of the noise, pixels.
    pub noise: f64,
    /// Prior standard deviation of the logarithm of the focal length; `None` when it was not estimated.
    pub focal_sd: Option<f64>,
    /// Variance of errors that neighbouring matches share, in multiples of that of independent ones
    /// ([`ScoreCells`](crate::likelihood::ScoreCells)).
    pub design_effect: f64,
    /// A free direction of translation, a unit vector of the camera frame, and the standard deviation that stands for
    /// an unknown value, map units.
    pub free: Option<(Vector3<f64>, f64)>,
}

/// One match with its weight.
struct WeightedResidual {
    residual: Residual,
    /// Probability that it is right, times its share of its keypoint and map point.
    right: f64,
    /// Variance caused by the map point's own error, pixels squared, mean over its residuals.
    map_variance: f64,
}

impl CovarianceInputs<'_> {
    /// Covariance of the pose, infinite on the diagonal when a direction is free, and its inverse; where a direction is
    /// free, the information about the others, and 0 when there are too few matches to estimate their noise.
    pub fn covariance_and_information(&self) -> (Symmetric6, Matrix6<f64>) {
        let Some((hessian, score_covariance)) = self.sandwich_terms() else {
            return (infinite(), Matrix6::zeros());
        };
        let covariance = sandwich(&hessian, &score_covariance);
        let inverse = covariance.and_then(|c| Matrix6::from_fn(|i, j| c[i][j]).try_inverse());
        let information = inverse.unwrap_or_else(|| hessian.fixed_view::<6, 6>(0, 0).clone_owned());
        (covariance.unwrap_or_else(infinite), information)
    }

    /// `H` and the matrix between its inverses; `None` when there are too few matches.
    fn sandwich_terms(&self) -> Option<(Matrix7, Matrix7)> {
        let rows = self.matches.residuals();
        let weighted_residuals = self.weighted_residuals();
        let agreeing: f64 = weighted_residuals.iter().map(|item| item.right).sum();
        let (variance, max_share) = self.variance(&weighted_residuals, agreeing)?;
        let map_variance = |item: &WeightedResidual| item.map_variance.min(max_share * variance);
        let mean =
            weighted_residuals.iter().map(|item| item.right * map_variance(item)).sum::<f64>() / agreeing;
        let (mut hessian, mut score_covariance) = (Matrix7::zeros(), Matrix7::zeros());
        for item in &weighted_residuals {
            let share = 1.0 + (map_variance(item) - mean) / variance;
            let factor = share.clamp(MIN_VARIANCE_SHARE, max_share);
            for row in 0..rows {
                let j = self.row(&item.residual, row);
                let weighted = j * (item.right / variance);
                // A loop over numbers is faster here than products of matrices.
                for k in 0..7 {
                    for l in 0..7 {
                        let square = weighted[l] * j[k];
                        hessian[(l, k)] += square;
                        score_covariance[(l, k)] += square * factor;
                    }
                }
            }
        }
        let mut known = Matrix7::zeros();
        known.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.priors.information(self.pose));
        if let Some((direction, sd)) = self.free {
            let mut shift = known.fixed_view_mut::<3, 3>(3, 3);
            shift += direction * direction.transpose() / (sd * sd);
        }
        known[(6, 6)] = self.focal_sd.map_or(1.0, |sd| sd.powi(-2));
        Some((hessian + known, score_covariance * self.design_effect + known))
    }

    fn weighted_residuals(&self) -> Vec<WeightedResidual> {
        let probability =
            |llr: f64| if llr > MIN_LOG_LIKELIHOOD_RATIO { 1.0 / (1.0 + (-llr).exp()) } else { 0.0 };
        let right: Vec<f64> = self.likelihoods.iter().map(|llr| probability(*llr)).collect();
        let shares = self.matches.shares(&right);
        let world_from_cam = self.pose.rotation().matrix().transpose();
        (0..right.len())
            .filter(|&i| right[i] > 0.0)
            .filter_map(|i| {
                let residual = self.matches.residual(i, self.pose, true)?;
                let map_variance = self.matches.point_covariance(i).map_or(0.0, |c| {
                    let c = Matrix3::from_fn(|a, b| c[a][b]);
                    let rows = self.matches.residuals();
                    let across = |row: usize| {
                        let j = residual.jacobian[row];
                        let j = world_from_cam * Vector3::new(j[3], j[4], j[5]);
                        j.dot(&(c * j))
                    };
                    (0..rows).map(across).sum::<f64>() / rows as f64
                });
                Some(WeightedResidual { residual, right: right[i] * shares[i], map_variance })
            })
            .collect()
    }

    /// `V`: effective variance of one residual, pixels squared, and the ratio of the largest squared score to the mean;
    /// `None` when there are too few.
    fn variance(&self, weighted_residuals: &[WeightedResidual], agreeing: f64) -> Option<(f64, f64)> {
        let scale = self.matches.freedom() * self.noise * self.noise;
        let rows = self.matches.residuals() as f64;
        let (mut pulls, mut slopes, mut squared_slopes) = (0.0, 0.0, 0.0);
        for item in weighted_residuals {
            let squared = item.residual.squared();
            let denominator = (scale + squared).powi(2);
            // Mean over the residuals of a match of the squared score and of its slope.
            let pull = 36.0 * squared / (denominator * rows);
            let slope = 6.0 * (scale + (1.0 - 2.0 / rows) * squared) / denominator;
            pulls += item.right * item.right * pull;
            let slope = item.right * slope - item.right * (1.0 - item.right).max(0.0) * pull;
            slopes += slope;
            squared_slopes += slope * slope;
        }
        let freedom = agreeing - 6.0 / rows;
        if !(freedom > 0.0 && slopes > 0.0 && pulls > 0.0) {
            return None;
        }
        let spread = (squared_slopes * agreeing / (slopes * slopes) - 1.0).max(0.0);
        let correction = 1.0 + 6.0 / rows / agreeing * spread;
        let variance = correction.powi(2) * pulls * agreeing / (slopes * slopes) * (agreeing / freedom);
        // Ψ² is largest at e² = ν σ²; `pulls` holds the mean over the residuals of a match.
        let largest = 36.0 / (4.0 * scale * rows);
        Some((variance, (largest * agreeing / pulls).max(1.0)))
    }

    fn row(&self, residual: &Residual, row: usize) -> SVector<f64, 7> {
        let j = residual.jacobian[row];
        let by_focal = if self.focal_sd.is_some() { residual.by_camera[row][0] } else { 0.0 };
        SVector::from([j[0], j[1], j[2], j[3], j[4], j[5], by_focal])
    }
}

/// `H⁻¹ B H⁻¹`, restricted to the pose; `None` when a direction is free.
fn sandwich(hessian: &Matrix7, score_covariance: &Matrix7) -> Option<Symmetric6> {
    // Radians and map units differ in scale: compare directions only after giving each unit information.
    let unit = hessian.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    let scale = Matrix7::from_diagonal(&unit);
    let inverse = scale * (scale * hessian * scale).cholesky()?.inverse() * scale;
    let covariance = inverse * score_covariance * inverse;
    (unit.min() > 0.0 && covariance.iter().all(|c| c.is_finite())).then(|| {
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[(i, j)] + covariance[(j, i)])))
    })
}

/// The covariance of a pose with an additional systematic shift: the outer product of the shift is added.
pub fn with_shift(covariance: &Symmetric6, shift: &[f64; 6]) -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| covariance[i][j] + shift[i] * shift[j]))
}

/// The covariance with one unknown direction of translation, a unit vector of the camera frame: infinite on the
/// diagonal wherever that direction has a component, with zero correlations.
pub fn free_along(covariance: &Symmetric6, direction: &Vector3<f64>) -> Symmetric6 {
    /// Components below this are rounding.
    const PART: f64 = 1e-9;
    let free = |k: usize| k >= 3 && direction[k - 3].abs() > PART;
    std::array::from_fn(|i| {
        std::array::from_fn(|j| match (free(i) || free(j), i == j) {
            (false, _) => covariance[i][j],
            (true, true) => f64::INFINITY,
            (true, false) => 0.0,
        })
    })
}
