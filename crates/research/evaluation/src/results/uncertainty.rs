//! Comparison of covariances and errors, of a query and of a row.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};
use veiloc_geometry::statistics::median;

use crate::results::coverage::{NormalizedError, shares};
use crate::results::metrics::finite;

/// The error of a pose relative to its covariance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct QueryUncertainty {
    /// Standard deviation of the camera's position in its least certain direction, map units, which is the ± of
    /// answers; null if a direction is unconstrained; absent without a pose.
    pub position_sd: Option<f64>,
    /// Standard deviation of the orientation about its least certain axis, degrees; null if it is unconstrained; absent
    /// without a pose.
    pub rotation_sd_deg: Option<f64>,
    /// Distance between the estimated and the true camera centre, divided by `position_sd`; null if a
    /// direction is unconstrained; absent without a pose. For right covariances its median lies between 0.67 (one dominant direction) and
    /// 1.54 (all directions equal).
    pub center_error_over_sd: Option<f64>,
    /// Probability of the smallest confidence region of the centre that contains the true centre, 0 to 1; absent
    /// without a pose.
    pub center_region: f64,
    /// The same for the whole pose, six dimensions; absent without a pose.
    pub pose_region: f64,
}

impl QueryUncertainty {
    /// Normalized error of an estimate with its covariance in the chart of [`CameraFromWorld::perturbed`].
    pub fn of(estimate: &CameraFromWorld, covariance: &[[f64; 6]; 6], truth: &CameraFromWorld) -> Self {
        let sd = position_sd(covariance);
        let normalized = NormalizedError::of(estimate, covariance, truth);
        let held = sd.is_finite() && sd > 0.0;
        Self {
            position_sd: finite(sd),
            rotation_sd_deg: finite(rotation_sd_degrees(covariance)),
            center_error_over_sd: held.then(|| estimate.center().distance(&truth.center()) / sd),
            center_region: normalized.center_region(),
            pose_region: normalized.pose_region(),
        }
    }
}

/// Coverage of the covariances of a row's trusted poses.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TrustedUncertainty {
    /// Coverage of the confidence regions of the camera centre: nominal percentage to share of true centres inside, 0
    /// to 1; absent without trusted poses.
    pub coverage: BTreeMap<String, f64>,
    /// The same for whole poses, six dimensions; absent without trusted poses.
    pub coverage_pose: BTreeMap<String, f64>,
    /// Median of the queries' `center_error_over_sd`: 0.67 to 1.54 for right covariances; null if more than half have an
    /// unconstrained direction; absent without trusted poses.
    pub center_error_over_sd: Option<f64>,
}

impl TrustedUncertainty {
    /// Coverage over these trusted poses; `None` without poses.
    pub fn of(each: &[QueryUncertainty]) -> Option<Self> {
        if each.is_empty() {
            return None;
        }
        let of = |region: fn(&QueryUncertainty) -> f64| shares(&each.iter().map(region).collect::<Vec<_>>());
        let ratios: Vec<f64> = each.iter().map(|u| u.center_error_over_sd.unwrap_or(f64::INFINITY)).collect();
        Some(Self {
            coverage: of(|u| u.center_region),
            coverage_pose: of(|u| u.pose_region),
            center_error_over_sd: finite(median(&ratios)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal(value: f64) -> [[f64; 6]; 6] {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { value } else { 0.0 }))
    }

    #[test]
    fn errors_are_normalized_by_their_deviation() {
        let truth = CameraFromWorld::identity();
        let estimate = truth.perturbed(&[0.0, 0.0, 0.0, 0.03, 0.0, 0.0]);
        let u = QueryUncertainty::of(&estimate, &diagonal(1e-4), &truth);
        let sd = u.position_sd.expect("finite");
        assert!((sd - 0.01).abs() < 1e-9, "{sd}");
        assert!((u.center_error_over_sd.expect("finite") - 3.0).abs() < 1e-9);
        // Three deviations along one axis: chi-squared 9 with three and with six degrees of freedom.
        assert!((u.center_region - 0.9707).abs() < 1e-3 && (u.pose_region - 0.8264).abs() < 1e-3, "{u:?}");
        let free = QueryUncertainty::of(&estimate, &diagonal(f64::INFINITY), &truth);
        assert_eq!((free.position_sd, free.center_error_over_sd, free.center_region), (None, None, 1.0));
    }

    #[test]
    fn coverage_is_the_share_of_poses() {
        let with = |region: f64| QueryUncertainty {
            position_sd: Some(0.01),
            rotation_sd_deg: Some(0.1),
            center_error_over_sd: Some(2.0 * region),
            center_region: region,
            pose_region: 0.95,
        };
        let row = TrustedUncertainty::of(&[with(0.3), with(0.7)]).expect("two");
        assert_eq!((row.coverage["50"], row.coverage["90"], row.coverage["99"]), (0.5, 1.0, 1.0));
        assert_eq!((row.coverage_pose["90"], row.coverage_pose["99"]), (0.0, 1.0));
        assert_eq!(row.center_error_over_sd, Some(1.0));
        assert_eq!(TrustedUncertainty::of(&[]), None);
    }
}
