//! The result of an estimation: a pose, its inliers, its uncertainty, and whether to trust it.

use veiloc_geometry::CameraFromWorld;

use crate::confidence::Confidence;
use crate::likelihood::{CameraEvidence, GravityTest};
use crate::rig::RigEstimate;

/// The pose of a camera, and its uncertainty.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseEstimate {
    /// The pose.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to, without duplicates of a match.
    pub inlier_keypoints: usize,
    /// Minimal samples drawn.
    pub hypotheses: usize,
    /// The minimised cost, lower is better: the MSAC value in units of whole outliers (between 0 and `N`), or minus the
    /// log likelihood ratio against "all are outliers" (below 0).
    pub score: f64,
    /// Standard deviation that the inliers show, pixels: across the line, for points along each axis.
    pub noise_px: f64,
    /// Estimated focal length relative to the given one; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Estimated principal point relative to the given one, pixels; 0 when it was not estimated.
    pub principal_shift_px: [f64; 2],
    /// The part of [`Self::covariance`] that is due to the camera model: errors of focal length, principal point and
    /// distortion, which all matches share.
    pub camera_covariance: [[f64; 6]; 6],
    /// What the matches say about the given camera, if [`crate::PoseOptions::camera_evidence`] asks for it.
    pub camera_evidence: Option<CameraEvidence>,
    /// The measured gravity direction against the pose of the matches alone; `None` without a measurement.
    pub gravity_test: Option<GravityTest>,
    /// Covariance in the chart of [`CameraFromWorld::perturbed`] (radians, then map units): from the noise of
    /// keypoints and map points, and from the camera model. Infinite on the diagonal when the inliers leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// The same from the matches alone, without camera priors ([`Gravity`](crate::Gravity),
    /// [`PositionPrior`](crate::PositionPrior)): the basis of trust.
    pub covariance_by_matches: [[f64; 6]; 6],
    /// A direction along which the camera's position is undetermined, a unit vector of the world frame: lines of one
    /// anchor do not constrain the position along its ray. The returned position is then one of many, and its variance
    /// along this direction is infinite.
    pub free_direction: Option<[f64; 3]>,
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// Another pose, which the matches that do not agree with this one support; `None` if they support none, or if it was
    /// not searched for ([`PoseOptions::fixed_hypotheses`](crate::PoseOptions::fixed_hypotheses), tracking).
    pub rival: Option<Rival>,
    /// Whether the final refinement was accepted. It is rejected when it makes the score worse.
    pub refined: bool,
}

/// Another pose that a part of the matches supports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rival {
    /// The pose.
    pub cam_from_world: CameraFromWorld,
    /// Its log evidence from the matches that do not agree with the best pose, as [`Confidence::log_evidence`].
    pub log_evidence: f64,
}

impl PoseEstimate {
    /// [`Self::covariance`] without the part that is due to the camera model: the noise of keypoints and map points
    /// alone.
    pub fn noise_covariance(&self) -> [[f64; 6]; 6] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j] - self.camera_covariance[i][j]))
    }

    /// Covariance of the camera centre in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.cam_from_world.center_covariance(&self.covariance)
    }
}

/// Of an image that is a rig by itself.
impl From<RigEstimate> for PoseEstimate {
    fn from(mut rig: RigEstimate) -> Self {
        let image = rig.frames.swap_remove(0);
        let rival = rig.rival.zip(rig.confidence.rival_log_evidence).map(|(pose, log_evidence)| Rival {
            cam_from_world: CameraFromWorld::new(*pose.rotation(), *pose.translation()),
            log_evidence,
        });
        Self {
            cam_from_world: image.cam_from_world,
            inliers: image.inliers,
            inlier_count: image.inlier_count,
            inlier_keypoints: image.inlier_keypoints,
            hypotheses: rig.hypotheses,
            score: rig.score,
            noise_px: image.noise_px.unwrap_or(f64::NAN),
            focal_scale: image.focal_scale,
            principal_shift_px: image.principal_shift_px,
            camera_covariance: rig.camera_covariance,
            camera_evidence: image.camera_evidence,
            gravity_test: image.gravity_test,
            covariance: rig.covariance,
            covariance_by_matches: rig.covariance_by_matches,
            free_direction: rig.free_direction,
            confidence: rig.confidence,
            rival,
            refined: rig.refined,
        }
    }
}
