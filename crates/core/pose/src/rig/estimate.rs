//! The result for a rig.

use veiloc_geometry::{CameraFromWorld, Pinhole, RigFromWorld};

use crate::confidence::Confidence;
use crate::likelihood::{CameraEvidence, GravityTest};

/// The pose of a rig, and its uncertainty.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RigEstimate {
    /// The pose of the rig.
    pub rig_from_world: RigFromWorld,
    /// Its covariance in the chart of [`RigFromWorld::perturbed`] (radians, then map units), the frames' deviations
    /// marginalised out. Infinite on the diagonal when the frames leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// The same from the matches alone, without camera priors: the basis of trust.
    pub covariance_by_matches: [[f64; 6]; 6],
    /// What errors of the cameras add to both, included in them.
    pub camera_covariance: [[f64; 6]; 6],
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// A direction along which the position is undetermined, as [`PoseEstimate::free_direction`](crate::PoseEstimate);
    /// `None` for matches of several frames.
    pub free_direction: Option<[f64; 3]>,
    /// Each frame, `[F]`, in the order given.
    pub frames: Vec<FrameEstimate>,
    /// Minimal samples drawn, of all frames together, with the focal length of the final search.
    pub hypotheses: usize,
    /// The minimised cost, lower is better: minus the gain of the frames by the pose, natural logarithm; large gains of
    /// one of several frames are saturated.
    pub score: f64,
    /// Another pose of the rig, which the matches that do not agree with this one support.
    pub rival: Option<RigFromWorld>,
    /// Whether the final refinement was accepted. It is rejected when it makes the objective worse.
    pub refined: bool,
}

/// One frame of a rig at the joint pose.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FrameEstimate {
    /// The pose of its camera: given by the odometry, corrected as far as its matches require and the odometry allows.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to.
    pub inlier_keypoints: usize,
    /// Estimated focal length relative to the given one, the same for all frames of one camera; 1 when it was not
    /// estimated.
    pub focal_scale: f64,
    /// Estimated principal point relative to the given one, pixels; 0 when it was not estimated, as for several frames.
    pub principal_shift_px: [f64; 2],
    /// Standard deviation that the inliers show, pixels; `None` without inliers.
    pub noise_px: Option<f64>,
    /// Distance of the camera from its pose by the odometry, in standard deviations (the norm of six numbers: 2.4 on
    /// average when the odometry's deviations are correct); 0 for a frame that is fixed to the rig.
    pub odometry_deviation: f64,
    /// The measured gravity direction against the pose of the matches alone; `None` without a measurement.
    pub gravity_test: Option<GravityTest>,
    /// What the matches say about the given camera, if [`crate::PoseOptions::camera_evidence`] asks for it; `None` for
    /// several frames.
    pub camera_evidence: Option<CameraEvidence>,
}

impl FrameEstimate {
    /// Of a frame without agreeing correspondences, of this number of them.
    pub(super) fn unseen(cam_from_world: CameraFromWorld, correspondences: usize) -> Self {
        Self {
            cam_from_world,
            inliers: vec![false; correspondences],
            inlier_count: 0,
            inlier_keypoints: 0,
            focal_scale: 1.0,
            principal_shift_px: [0.0; 2],
            noise_px: None,
            odometry_deviation: 0.0,
            gravity_test: None,
            camera_evidence: None,
        }
    }

    /// The camera as it was estimated, from the given one.
    pub(crate) fn camera_of(&self, given: &Pinhole) -> Pinhole {
        let [dx, dy] = self.principal_shift_px;
        Pinhole {
            focal: given.focal.map(|f| f * self.focal_scale),
            principal: [given.principal[0] + dx, given.principal[1] + dy],
            ..*given
        }
    }
}

impl RigEstimate {
    /// [`Self::covariance`] without the part that is due to the camera models: the noise of keypoints and map points
    /// alone.
    pub fn noise_covariance(&self) -> [[f64; 6]; 6] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j] - self.camera_covariance[i][j]))
    }

    /// Covariance of the rig's origin in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.rig_from_world.center_covariance(&self.covariance)
    }
}
