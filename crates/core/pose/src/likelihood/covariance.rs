//! How firmly a pose is held: the covariance of an estimate, with all that takes part in its error.
//!
//! That of an M-estimator (Huber and Ronchetti, *Robust Statistics*, 2009, eq. 7.43): with `r` the probability that a
//! match is right, `Ψ = r · 6 e / (ν σ² + e²)` its pull on the pose and `Ψ′` the derivative, in which a match that is
//! pushed out loses its say,
//!
//! ```text
//! V = K² · n/(n − p) · (Σ Ψ² / n) / (Σ Ψ′ / n)²      K = 1 + p/n · Var Ψ′ / (E Ψ′)²
//! C = H⁻¹ (Σ r f JᵀJ / V + P) H⁻¹                    H = Σ r JᵀJ / V + P
//! ```
//!
//! with `n = Σ r` and `p = 6` over the residuals of a match. It asks what the residuals are, not what the model says they
//! should be: it stays right when they are not Student's. Further
//!
//! - **a keypoint counts once**, however many map points it was matched to, and so does a map point: their matches share
//!   one error, so each has its share of `r`;
//! - **the map's own error** takes part: `f` is a match's variance over the mean one, by the covariance of its map point
//!   as it shows in the image;
//! - `P` is what is known beside the matches ([`PosePriors`]);
//! - a focal length that was estimated is a seventh number, and what it leaves open is in `C`.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3};

use crate::likelihood::fisher::{NEGLIGIBLE, Symmetric6, infinite};
use crate::likelihood::matches::{Matches, Residual};
use crate::likelihood::pose_priors::PosePriors;

type Matrix7 = SMatrix<f64, 7, 7>;

/// The least a match's variance may be of the mean one: the map's covariances say where points are worse, not that one is
/// perfect.
const LEAST_SHARE: f64 = 0.2;

/// An estimate whose covariance is asked for.
pub struct Estimated<'a> {
    /// The correspondences, as the pose sees them.
    pub matches: &'a Matches<'a>,
    /// What is known beside them.
    pub priors: &'a PosePriors,
    /// The pose.
    pub pose: &'a CameraFromWorld,
    /// Log likelihood ratios at the pose, `[N]`.
    pub likelihoods: &'a [f64],
    /// Scale of the noise, pixels.
    pub noise: f64,
    /// Standard deviation that the logarithm of the focal length had before; `None` when it was not estimated.
    pub focal_sd: Option<f64>,
    /// A direction of translation that the matches leave free, a unit vector of the camera frame, and the standard deviation
    /// that stands for knowing nothing, map units.
    pub free: Option<(Vector3<f64>, f64)>,
}

/// One match that has a say.
struct Say {
    residual: Residual,
    /// Probability that it is right, times its share of its keypoint and map point.
    right: f64,
    /// Variance that the map point's own error brings, pixels squared, mean over its residuals.
    map_variance: f64,
}

impl Estimated<'_> {
    /// Covariance of the pose; infinite on the diagonal when a direction is left free.
    pub fn covariance(&self) -> Symmetric6 {
        self.held_and_shaken().and_then(|(held, shaken)| sandwich(&held, &shaken)).unwrap_or_else(infinite)
    }

    /// Its inverse; where a direction is left free, what is known about the others. 0 when the matches are too few to show
    /// their noise.
    pub fn information(&self) -> Matrix6<f64> {
        let Some((held, shaken)) = self.held_and_shaken() else { return Matrix6::zeros() };
        let covariance = sandwich(&held, &shaken).map(|c| Matrix6::from_fn(|i, j| c[i][j]));
        covariance
            .and_then(|c| c.try_inverse())
            .unwrap_or_else(|| held.fixed_view::<6, 6>(0, 0).clone_owned())
    }

    /// `H` and what stands between its inverses; `None` when the matches are too few.
    fn held_and_shaken(&self) -> Option<(Matrix7, Matrix7)> {
        let rows = self.matches.residuals();
        let says = self.says();
        let agreeing: f64 = says.iter().map(|say| say.right).sum();
        let variance = self.variance(&says, agreeing)?;
        let mean = says.iter().map(|say| say.right * say.map_variance).sum::<f64>() / agreeing;
        let (mut held, mut shaken) = (Matrix7::zeros(), Matrix7::zeros());
        for say in &says {
            let factor = (1.0 + (say.map_variance - mean) / variance).max(LEAST_SHARE);
            for row in 0..rows {
                let j = self.row(&say.residual, row);
                let square = j * j.transpose() * (say.right / variance);
                held += square;
                shaken += square * factor;
            }
        }
        let mut known = Matrix7::zeros();
        known.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.priors.information(self.pose));
        if let Some((direction, sd)) = self.free {
            let mut shift = known.fixed_view_mut::<3, 3>(3, 3);
            shift += direction * direction.transpose() / (sd * sd);
        }
        known[(6, 6)] = self.focal_sd.map_or(1.0, |sd| sd.powi(-2));
        Some((held + known, shaken + known))
    }

    fn says(&self) -> Vec<Say> {
        let probability = |llr: f64| if llr > NEGLIGIBLE { 1.0 / (1.0 + (-llr).exp()) } else { 0.0 };
        let right: Vec<f64> = self.likelihoods.iter().map(|llr| probability(*llr)).collect();
        let shares = self.matches.shares(&right);
        let turn = self.pose.rotation().matrix();
        (0..right.len())
            .filter(|&i| right[i] > 0.0)
            .filter_map(|i| {
                let residual = self.matches.residual(i, self.pose, true)?;
                let map_variance = self.matches.point_covariance(i).map_or(0.0, |c| {
                    let c = turn * Matrix3::from_fn(|a, b| c[a][b]) * turn.transpose();
                    let rows = self.matches.residuals();
                    let across = |row: usize| {
                        let j = residual.jacobian[row];
                        let j = Vector3::new(j[3], j[4], j[5]);
                        j.dot(&(c * j))
                    };
                    (0..rows).map(across).sum::<f64>() / rows as f64
                });
                Some(Say { residual, right: right[i] * shares[i], map_variance })
            })
            .collect()
    }

    /// `V`: variance of one residual as the pose feels it, pixels squared; `None` when there are too few.
    fn variance(&self, says: &[Say], agreeing: f64) -> Option<f64> {
        let scale = self.matches.freedom() * self.noise * self.noise;
        let rows = self.matches.residuals() as f64;
        let (mut pulls, mut slopes, mut squared_slopes) = (0.0, 0.0, 0.0);
        for say in says {
            let squared = say.residual.squared();
            let denominator = (scale + squared).powi(2);
            // Mean over the residuals of a match of the squared pull and of the slope.
            let pull = 36.0 * squared / (denominator * rows);
            let slope = 6.0 * (scale + (1.0 - 2.0 / rows) * squared) / denominator;
            pulls += say.right * say.right * pull;
            let slope = say.right * slope - say.right * (1.0 - say.right).max(0.0) * pull;
            slopes += slope;
            squared_slopes += slope * slope;
        }
        let freedom = agreeing - 6.0 / rows;
        if !(freedom > 0.0 && slopes > 0.0 && pulls > 0.0) {
            return None;
        }
        let spread = (squared_slopes * agreeing / (slopes * slopes) - 1.0).max(0.0);
        let correction = 1.0 + 6.0 / rows / agreeing * spread;
        Some(correction.powi(2) * pulls * agreeing / (slopes * slopes) * (agreeing / freedom))
    }

    fn row(&self, residual: &Residual, row: usize) -> SVector<f64, 7> {
        let j = residual.jacobian[row];
        let by_focal = if self.focal_sd.is_some() { residual.by_log_focal[row] } else { 0.0 };
        SVector::from([j[0], j[1], j[2], j[3], j[4], j[5], by_focal])
    }
}

/// `H⁻¹ B H⁻¹`, the part of the pose; `None` when a direction is left free.
fn sandwich(held: &Matrix7, shaken: &Matrix7) -> Option<Symmetric6> {
    // Radians and map units differ in scale: compare directions only after giving each unit information.
    let unit = held.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    let scale = Matrix7::from_diagonal(&unit);
    let inverse = scale * (scale * held * scale).cholesky()?.inverse() * scale;
    let covariance = inverse * shaken * inverse;
    (unit.min() > 0.0 && covariance.iter().all(|c| c.is_finite())).then(|| {
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[(i, j)] + covariance[(j, i)])))
    })
}

/// The covariance of a pose that may be off by so much beside its noise: the square of the shift is added.
pub fn with_shift(covariance: &Symmetric6, shift: &[f64; 6]) -> Symmetric6 {
    std::array::from_fn(|i| std::array::from_fn(|j| covariance[i][j] + shift[i] * shift[j]))
}

/// The covariance with nothing known along one direction of translation, a unit vector of the camera frame: infinite on
/// the diagonal wherever that direction has a part, and nothing said beside it.
pub fn free_along(covariance: &Symmetric6, direction: &Vector3<f64>) -> Symmetric6 {
    /// Parts below this are rounding.
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
