//! Result for one image under one scheme.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix6, Vector6};
use veiloc_localization::Localization;
use veiloc_map::{CovarianceCalibration, MapModel};
use veiloc_pose::Doubt;
use veiloc_pose::likelihood::CameraEvidence;

/// An estimated pose of an image, and its error.
#[derive(Debug, Clone, PartialEq)]
pub struct SelfTestTrial {
    /// Step from the estimated pose to the true one, in the chart of [`CameraFromWorld::perturbed`]: radians, then map
    /// units.
    pub step: [f64; 6],
    /// The estimator's own covariance in that chart.
    pub covariance: [[f64; 6]; 6],
    /// The part of it that comes from the camera model.
    pub camera_covariance: [[f64; 6]; 6],
    /// Whether the pose is trusted, given that its camera is right: it is the map's own.
    pub trusted: bool,
    /// Keypoint noise estimated from the inliers, pixels.
    pub noise_px: f64,
    /// What the matches say about the camera of the image.
    pub camera_evidence: Option<CameraEvidence>,
    /// The map image nearest to the other pose that the query's matches support, if there is one: a place that looks
    /// alike.
    pub looks_like: Option<usize>,
}

impl SelfTestTrial {
    pub(crate) fn of(model: &MapModel, found: &Localization, truth: &CameraFromWorld) -> Self {
        Self {
            step: found.cam_from_world.step_to(truth),
            covariance: found.own_covariance,
            camera_covariance: found.camera_covariance,
            trusted: found.confidence.doubts().iter().all(Doubt::is_of_camera),
            noise_px: found.noise_px,
            camera_evidence: found.camera_evidence,
            looks_like: other_place(model, found, truth),
        }
    }

    /// Error of the rotation, degrees.
    pub(crate) fn rotation_deg(&self) -> f64 {
        length(&self.step[..3]).to_degrees()
    }

    /// Error of the camera centre, map units; a rotation about the centre does not change it.
    pub(crate) fn translation(&self) -> f64 {
        length(&self.step[3..])
    }

    /// Returns whether the trial can calibrate covariances.
    pub(crate) fn is_usable(&self) -> bool {
        self.trusted
            && self.step.iter().chain(self.covariance.iter().flatten()).all(|v| v.is_finite())
            && self
                .squared_distances(&CovarianceCalibration {
                    factor: 1.0,
                    rotation_floor: 0.0,
                    translation_floor: 0.0,
                })
                .is_some()
    }

    /// Squared error in units of the calibrated covariance, for the centre and for the pose, and half the logarithm of
    /// the covariance's determinant; `None` if the matrix is not a covariance.
    pub(crate) fn squared_distances(&self, calibration: &CovarianceCalibration) -> Option<Distances> {
        let c = calibration.apply(&self.covariance, &self.camera_covariance);
        let pose = Matrix6::from_fn(|i, j| c[i][j]).cholesky()?;
        let center = pose_center(&c).cholesky()?;
        let step = Vector6::from(self.step);
        let shift = step.fixed_rows::<3>(3).into_owned();
        let distances = Distances {
            center: shift.dot(&center.solve(&shift)),
            pose: step.dot(&pose.solve(&step)),
            half_log_det: pose.l().diagonal().iter().map(|d| d.ln()).sum(),
        };
        [distances.center, distances.pose, distances.half_log_det]
            .iter()
            .all(|v| v.is_finite())
            .then_some(distances)
    }
}

/// The map image nearest to whichever of two supported poses is farther from the true one; `None` with one pose.
fn other_place(model: &MapModel, found: &Localization, truth: &CameraFromWorld) -> Option<usize> {
    let poses = [found.cam_from_world, found.rival?.cam_from_world];
    let other = poses.into_iter().max_by(|a, b| {
        a.center().distance(&truth.center()).total_cmp(&b.center().distance(&truth.center()))
    })?;
    let distance = |image: &usize| model.images[*image].cam_from_world.center().distance(&other.center());
    (0..model.images.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// See [`SelfTestTrial::squared_distances`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Distances {
    pub(crate) center: f64,
    pub(crate) pose: f64,
    pub(crate) half_log_det: f64,
}

fn pose_center(c: &[[f64; 6]; 6]) -> veiloc_geometry::nalgebra::Matrix3<f64> {
    veiloc_geometry::nalgebra::Matrix3::from_fn(|i, j| c[3 + i][3 + j])
}

fn length(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
