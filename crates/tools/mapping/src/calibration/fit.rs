//! Calibration of a map's pose covariances, fitted to the observed pose errors.
//!
//! Let `e` be the step from a trusted pose to the true one and `C` the estimator's covariance. The parameters `a`,
//! `s_r` and `s_t` of [`CovarianceCalibration`] maximize the posterior probability under
//! `e ~ N(0, a C + diag(s_r² I, s_t² I))` with log-normal priors about [`CovarianceCalibration::unmeasured`]. The
//! priors count like one or two images, so that a handful of images cannot dominate.
//!
//! # Outliers
//! A trusted pose may be wrong. A first fit with a heavy-tailed distribution (Student's t with [`FREEDOM`] degrees of
//! freedom) finds the poses beyond [`MAX_SQUARED_DISTANCE`]; the second fit leaves them out, but at most a tenth of
//! all: frequent errors are not outliers, and the covariances must cover them.
//!
//! # Tails
//! Real errors have heavier tails than a normal distribution. If the region of 90 % holds fewer than 90 % of all
//! errors, `a`, `s_r²` and `s_t²` are multiplied by a common factor until it does. So the regions of high probability
//! hold what they say, and those of low probability hold more.

use veiloc_map::CovarianceCalibration;

use crate::calibration::minimum::minimum;
use crate::calibration::radii::{SQUARED_RADII_3, SQUARED_RADII_6};
use crate::calibration::trial::SelfTestTrial;

/// Fits the calibration of a scheme; `scale` is the typical distance of observed points, map units.
///
/// Trials that are not trusted, or leave a direction unconstrained, are ignored. Without usable trials the result is
/// [`CovarianceCalibration::unmeasured`].
pub fn fit(trials: &[SelfTestTrial], scale: f64) -> CovarianceCalibration {
    let prior = CovarianceCalibration::unmeasured(scale);
    let usable: Vec<&SelfTestTrial> = trials.iter().filter(|t| t.is_usable()).collect();
    if usable.is_empty() || !(prior.translation_floor > 0.0) {
        return prior;
    }
    let heavy = most_probable(&usable, &prior, Tail::Heavy);
    let inliers = without_outliers(&usable, &heavy);
    widened(&usable, most_probable(&inliers, &prior, Tail::Normal))
}

/// The calibration, multiplied until the regions of 90 % of centre and pose hold 90 % of the trials.
fn widened(trials: &[&SelfTestTrial], fitted: CovarianceCalibration) -> CovarianceCalibration {
    let at = |scale: f64| CovarianceCalibration {
        factor: fitted.factor * scale * scale,
        rotation_floor: fitted.rotation_floor * scale,
        translation_floor: fitted.translation_floor * scale,
    };
    let covers = |calibration: &CovarianceCalibration| {
        let inside = |t: &&&SelfTestTrial| {
            t.squared_distances(calibration)
                .is_some_and(|d| d.center <= SQUARED_RADII_3[1] && d.pose <= SQUARED_RADII_6[1])
        };
        10 * trials.iter().filter(inside).count() >= 9 * trials.len()
    };
    if trials.len() < MIN_TRIALS_FOR_TAILS || covers(&fitted) {
        return fitted;
    }
    let (mut narrow, mut wide) = (1.0, MAX_WIDENING);
    for _ in 0..WIDENING_STEPS {
        let middle = f64::midpoint(narrow, wide);
        if covers(&at(middle)) { wide = middle } else { narrow = middle }
    }
    at(wide)
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Tail {
    Normal,
    Heavy,
}

fn most_probable(
    trials: &[&SelfTestTrial],
    prior: &CovarianceCalibration,
    tail: Tail,
) -> CovarianceCalibration {
    let at = |log: &[f64; 3]| CovarianceCalibration {
        factor: prior.factor * log[0].exp(),
        rotation_floor: prior.rotation_floor * log[1].exp(),
        translation_floor: prior.translation_floor * log[2].exp(),
    };
    let loss = |log: &[f64; 3]| {
        let calibration = at(log);
        let of_prior: f64 = log.iter().zip(PRIOR_SD).map(|(l, sd)| 0.5 * (l / sd).powi(2)).sum();
        let of_trials = trials.iter().map(|t| {
            t.squared_distances(&calibration).map_or(f64::INFINITY, |d| {
                d.half_log_det
                    + match tail {
                        Tail::Normal => 0.5 * d.pose,
                        Tail::Heavy => 0.5 * (FREEDOM + 6.0) * (d.pose / FREEDOM).ln_1p(),
                    }
            })
        });
        of_prior + of_trials.sum::<f64>()
    };
    at(&minimum(loss, [0.0; 3], 0.7))
}

/// Leaves out the trials beyond [`MAX_SQUARED_DISTANCE`] under a first calibration, at most a tenth.
fn without_outliers<'a>(
    trials: &[&'a SelfTestTrial],
    calibration: &CovarianceCalibration,
) -> Vec<&'a SelfTestTrial> {
    let mut ranked: Vec<(f64, &'a SelfTestTrial)> = trials
        .iter()
        .map(|t| (t.squared_distances(calibration).map_or(f64::INFINITY, |d| d.pose), *t))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let min_kept = ranked.len() - ranked.len() / 10;
    ranked
        .into_iter()
        .enumerate()
        .filter(|(i, (d, _))| *i < min_kept || *d < MAX_SQUARED_DISTANCE)
        .map(|(_, (_, t))| t)
        .collect()
}

/// Degrees of freedom of the heavy-tailed distribution of the first fit.
const FREEDOM: f64 = 5.0;
/// Squared distance under the first fit from which a pose is an outlier. For normal errors that fit estimates the
/// covariance at about 0.8, so this corresponds to the region of 99.99 %.
const MAX_SQUARED_DISTANCE: f64 = 35.0;
/// Fewer trials than this say nothing about tails.
const MIN_TRIALS_FOR_TAILS: usize = 10;
/// Maximum factor on standard deviations by which tails widen a calibration.
const MAX_WIDENING: f64 = 3.0;
/// Bisections: the factor is exact to a hundredth.
const WIDENING_STEPS: usize = 8;
/// Standard deviations of the logarithms of `a`, `s_r` and `s_t` about their defaults.
const PRIOR_SD: [f64; 3] = [0.5, 1.0, 1.0];
