//! What an estimation tells: a pose, who agrees with it, how well it is known, and whether to trust it.

use veiloc_geometry::CameraFromWorld;

use crate::confidence::Confidence;

/// Where the camera was, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseEstimate {
    /// The pose.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to.
    pub inlier_keypoints: usize,
    /// Minimal samples drawn.
    pub hypotheses: usize,
    /// What the search minimised, lower is better: the MSAC value in units of whole outliers (between 0 and `N`), or
    /// minus the log likelihood ratio against "all are outliers" (below 0).
    pub score: f64,
    /// Standard deviation that the inliers show, pixels: across the line, for points along each axis.
    pub noise_px: f64,
    /// Estimated focal length over the given one; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Covariance in the chart of [`CameraFromWorld::perturbed`] (radians, then map units): the variance of the
    /// inliers' residuals times the inverse of `JᵀJ`. Infinite on the diagonal when the inliers leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// The same by the matches alone, without what was told beside them ([`Gravity`](crate::Gravity),
    /// [`PositionPrior`](crate::PositionPrior)): what trust is told by.
    pub covariance_by_matches: [[f64; 6]; 6],
    /// A direction along which nothing says where the camera is, a unit vector of the world frame: lines of one anchor say
    /// nothing along its ray. The position is then one of many, and the variance along it infinite.
    pub free_direction: Option<[f64; 3]>,
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// Whether the final refinement was kept. It is dropped when it made the score worse.
    pub refined: bool,
}

impl PoseEstimate {
    /// Covariance of the camera centre in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.cam_from_world.center_covariance(&self.covariance)
    }
}
