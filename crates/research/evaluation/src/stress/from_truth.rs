//! Losses of the search: the same query optimized from its true pose, which only an evaluation knows.

use serde::Serialize;
use veiloc_geometry::{CameraFromWorld, Pixel};
use veiloc_localization::{LocalizeOptions, match_query};
use veiloc_map::MapFile;
use veiloc_pose::{PoseError as NoPose, PoseEstimate, optimize_pose, refine_pose};
use veiloc_protocol::SealedQuery;

use crate::pipeline::SealedBytes;
use crate::pose::true_matches;
use crate::results::metrics::PoseErrors;

/// Errors of one query's estimates that start from the true pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TruthStartErrors {
    /// The engine's own optimum, over all matches: the result of a perfect search; absent without `--optimum`.
    pub optimum: ErrorDocument,
    /// Least squares on the true matches: a lower limit for estimators; absent without `--optimum`.
    pub floor: ErrorDocument,
}

/// Errors of a pose in a document.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ErrorDocument {
    /// Rotation error, degrees; null without a pose.
    pub rotation_error_deg: Option<f64>,
    /// Translation error, map units; null without a pose.
    pub translation_error: Option<f64>,
}

impl ErrorDocument {
    /// Errors of a query without a pose.
    pub(super) const NOT_LOCALIZED: Self = Self { rotation_error_deg: None, translation_error: None };

    /// Errors of an estimate.
    pub(super) fn of(estimate: &CameraFromWorld, truth: &CameraFromWorld) -> Self {
        let error = PoseErrors::of(estimate, truth);
        if !(error.rotation_deg.is_finite() && error.translation.is_finite()) {
            return Self::NOT_LOCALIZED;
        }
        Self { rotation_error_deg: Some(error.rotation_deg), translation_error: Some(error.translation) }
    }

    /// The errors as comparable numbers.
    pub(super) fn pose_error(&self) -> PoseErrors {
        match (self.rotation_error_deg, self.translation_error) {
            (Some(rotation_deg), Some(translation)) => PoseErrors { rotation_deg, translation },
            _ => PoseErrors::NOT_LOCALIZED,
        }
    }
}

impl TruthStartErrors {
    /// Result of a query that could not be sealed.
    pub(super) const UNSEALED: Self =
        Self { optimum: ErrorDocument::NOT_LOCALIZED, floor: ErrorDocument::NOT_LOCALIZED };

    /// Result of a query that was sent, with the server's matches. A match is true within `radius_px` of its
    /// keypoint.
    pub(super) fn of(
        sent: &SealedBytes,
        truth: &CameraFromWorld,
        map: &MapFile,
        options: &LocalizeOptions,
        radius_px: f64,
    ) -> Self {
        let decoded = SealedQuery::decode(&sent.bytes).ok();
        let Some(matched) = decoded.and_then(|query| match_query(&query, map, options).ok()) else {
            return Self::UNSEALED;
        };
        let keypoints: &[Pixel] = &sent.truth.pixels;
        let right = true_matches(&matched.problem, truth, keypoints, radius_px);
        let error = |estimate: Result<PoseEstimate, NoPose>| {
            estimate.map_or(ErrorDocument::NOT_LOCALIZED, |e| ErrorDocument::of(&e.cam_from_world, truth))
        };
        Self {
            optimum: error(optimize_pose(&matched.problem, truth, &options.pose)),
            floor: error(refine_pose(&matched.problem, truth, &right, &options.pose)),
        }
    }
}
