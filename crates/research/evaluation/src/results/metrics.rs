//! Pose errors and their statistics over many queries.
//!
//! A query without a pose counts as infinite error in every median and recall, so no figure improves by giving up.

use std::fmt;
use std::str::FromStr;

use veiloc_geometry::CameraFromWorld;

/// Errors of one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseErrors {
    /// Degrees.
    pub rotation_deg: f64,
    /// `‖Rᵀt − R̂ᵀt̂‖`, map units.
    pub translation: f64,
}

impl PoseErrors {
    /// Errors of a query without a pose.
    pub const NOT_LOCALIZED: Self = Self { rotation_deg: f64::INFINITY, translation: f64::INFINITY };

    /// Errors of an estimate.
    pub fn of(estimate: &CameraFromWorld, truth: &CameraFromWorld) -> Self {
        Self {
            rotation_deg: estimate.rotation_error_degrees(truth),
            translation: estimate.translation_error(truth),
        }
    }

    /// Whether both errors are within a threshold; false for NaN.
    pub fn within(&self, threshold: &Threshold) -> bool {
        self.rotation_deg <= threshold.rotation_deg && self.translation <= threshold.translation
    }
}

/// A bound on both errors, written `translation/degrees`: `0.05/5` is 5 cm and 5° in a map of metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Threshold {
    /// Map units.
    pub translation: f64,
    /// Degrees.
    pub rotation_deg: f64,
}

/// A text that is not of the form `translation/degrees`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no threshold; write TRANSLATION/DEGREES, both positive, as in 0.05/5")]
pub struct ThresholdError(String);

impl FromStr for Threshold {
    type Err = ThresholdError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let read = || {
            let (translation, rotation) = text.split_once('/')?;
            let positive = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
            Some(Self { translation: positive(translation)?, rotation_deg: positive(rotation)? })
        };
        read().ok_or_else(|| ThresholdError(text.to_owned()))
    }
}

impl fmt::Display for Threshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.translation, self.rotation_deg)
    }
}

/// Share of poses within a threshold, 0 to 1; 0 without poses.
pub fn recall(errors: &[PoseErrors], threshold: &Threshold) -> f64 {
    if errors.is_empty() {
        return 0.0;
    }
    errors.iter().filter(|e| e.within(threshold)).count() as f64 / errors.len() as f64
}

/// The mean of the values; NaN without values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Maps values that are not finite to null, since JSON has no infinity.
pub fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// ROC AUC: probability that a value of the first list is larger than one of the second; ties count half. `None` if one
/// list is empty.
pub(crate) fn roc_auc(above: &[f64], below: &[f64]) -> Option<f64> {
    let mut sorted = below.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let won = |value: &f64| {
        let less = sorted.partition_point(|other| other < value);
        let equal = sorted.partition_point(|other| other <= value) - less;
        less as f64 + 0.5 * equal as f64
    };
    let pairs = above.len() as f64 * below.len() as f64;
    (pairs > 0.0).then(|| above.iter().map(won).sum::<f64>() / pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_poses_never_improve_figures() {
        let good = PoseErrors { rotation_deg: 0.1, translation: 0.01 };
        let threshold: Threshold = "0.05/5".parse().expect("well written");
        let all = [good, good, PoseErrors::NOT_LOCALIZED];
        assert!((recall(&all, &threshold) - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(recall(&[], &threshold), 0.0);
        let broken = PoseErrors { rotation_deg: f64::NAN, translation: 0.0 };
        assert_eq!(recall(&[broken], &threshold), 0.0);
    }

    #[test]
    fn thresholds_round_trip() {
        for text in ["0.05/5", "0.25/2", "5/10"] {
            assert_eq!(text.parse::<Threshold>().expect("well written").to_string(), text);
        }
        for text in ["", "5", "5/", "/5", "a/b", "-1/5", "0/5", "NaN/5", "inf/1"] {
            assert!(text.parse::<Threshold>().is_err(), "{text:?}");
        }
    }
}
