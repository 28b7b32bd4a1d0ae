//! One image, prepared for the search and the refinement: its correspondences under one camera, their likelihood, and
//! its hypotheses.

use rand::Rng;
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{CameraFromRig, CameraFromWorld};

use super::odometry::OdometryConstraint;
use crate::error::PoseError;
use crate::likelihood::{
    CameraChange, CameraObjective, Correspondences, FocalPrior, Kernel, MIN_LOG_LIKELIHOOD_RATIO, Matches,
    Objective, PosePriors, PoseProblem, Scale, ScoreCells, System, log_farthest, median_point,
};
use crate::options::PoseOptions;
use crate::ransac::minimal::Minimal;
use crate::ransac::sampler::WeightedSampler;

/// One image of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFrame {
    /// Its correspondences with the map; may be too few for a pose.
    pub problem: PoseProblem,
    /// Its pose on the rig, from the device's odometry.
    pub cam_from_rig: CameraFromRig,
    /// Standard deviation of that rotation about each axis, degrees; deviations of different frames are assumed to be
    /// independent. With 0 here and in [`Self::translation_sd`] the frame is fixed to the rig.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the camera's position on the rig along each axis, map units.
    pub translation_sd: f64,
}

impl RigFrame {
    /// The only frame of a rig whose pose is the camera's.
    pub(crate) fn alone(problem: PoseProblem) -> Self {
        let cam_from_rig = CameraFromRig::identity();
        Self { problem, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 }
    }

    /// Whether there are enough correspondences for a hypothesis; an error when the frame is invalid.
    pub(crate) fn has_minimal_sample(&self) -> Result<bool, PoseError> {
        if !self.cam_from_rig.is_finite() {
            return Err(PoseError::OdometryNotFinite);
        }
        for (what, value) in [
            ("standard deviation of the rotation on the rig", self.rotation_sd_deg),
            ("standard deviation of the position on the rig", self.translation_sd),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(PoseError::BadValue { what, value });
            }
        }
        match self.problem.check() {
            Ok(()) => Ok(true),
            Err(PoseError::TooFew { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// The constraint of its odometry. `matches` are its correspondences.
    pub(super) fn constraint(&self, matches: &Matches<'_>) -> OdometryConstraint {
        let scene = scene_size(matches, &self.problem);
        let rotation_sd = self.rotation_sd_deg.to_radians();
        OdometryConstraint::new(self.cam_from_rig, rotation_sd, self.translation_sd, scene)
    }
}

/// Size of the scene, map units: the typical distance of cameras from it.
fn scene_size(matches: &Matches<'_>, problem: &PoseProblem) -> f64 {
    let mut distances: Vec<f64> = if let Some(seen_from) = &problem.seen_from {
        matches.points.iter().zip(seen_from).map(|(p, s)| (p - s.center.coords).norm()).collect()
    } else {
        let center = median_point(&matches.points);
        matches.points.iter().map(|p| (p - center).norm()).collect()
    };
    upper_median(&mut distances).unwrap_or(f64::NAN)
}

/// A frame with correspondences.
pub(super) struct Frame<'a> {
    /// Its index in the caller's list.
    pub(crate) index: usize,
    pub(crate) problem: &'a PoseProblem,
    /// Its correspondences with the given camera.
    given: &'a Matches<'a>,
    /// The same as the best pose sees them, once there is one.
    seen: Matches<'a>,
    /// The same with the camera of the search or refinement.
    matches: Matches<'a>,
    kernel: Kernel,
    minimal: Minimal,
    priors: PosePriors,
    /// Noise of the matches at the camera pose given by the odometry: their own and the odometry's together, pixels.
    pub(super) rigid_noise: f64,
    /// Upper bound of any pose's gain at that noise.
    pub(super) most: f64,
    /// Probability that a sample is right; 0 when it cannot be drawn from.
    pub(super) promise: f64,
}

impl<'a> Frame<'a> {
    /// `given` are the correspondences with the given focal length, `factor` is that of the search relative to it.
    pub(super) fn new(
        index: usize,
        frame: &'a RigFrame,
        given: &'a Matches<'a>,
        factor: f64,
        has_minimal_sample: bool,
        options: &PoseOptions,
    ) -> Self {
        let zoomed = given.with_focal(factor);
        let focal = f64::midpoint(zoomed.camera.focal[0], zoomed.camera.focal[1]);
        let shift = frame.translation_sd / scene_size(&zoomed, &frame.problem);
        let by_odometry =
            focal * frame.rotation_sd_deg.to_radians().hypot(if shift.is_finite() { shift } else { 0.0 });
        let rigid_noise = options.noise_px.hypot(by_odometry);
        let all = WeightedSampler::new(zoomed.inlier_prior.iter().copied().enumerate());
        let promise =
            all.expected_share().powi(i32::try_from(zoomed.observations.sample_size()).unwrap_or(i32::MAX));
        Self {
            index,
            problem: &frame.problem,
            given,
            seen: given.clone(),
            kernel: Kernel::new(&zoomed, Scale::Likelihood { noise: rigid_noise }),
            minimal: Minimal::new(&zoomed, options.solver(), None, options.noise_px),
            priors: PosePriors::default(),
            rigid_noise,
            most: max_gain(&zoomed, rigid_noise),
            promise: if has_minimal_sample { promise } else { 0.0 },
            matches: zoomed,
        }
    }

    /// Uses these camera priors, and gravity for the hypotheses if it is among them.
    pub(super) fn use_priors(&mut self, priors: PosePriors, options: &PoseOptions) {
        let gravity = |priors: &PosePriors| self.problem.gravity.filter(|_| priors.has_gravity());
        if gravity(&priors).is_some() || gravity(&self.priors).is_some() {
            let gravity = gravity(&priors);
            self.minimal = Minimal::new(&self.matches, options.solver(), gravity.as_ref(), options.noise_px);
        }
        self.priors = priors;
    }

    /// Removes the gravity direction from the camera priors of a refinement.
    pub(super) fn without_gravity(&mut self) {
        self.priors = self.priors.without_gravity();
    }

    /// Restricts the correspondences to what this pose can see.
    pub(super) fn restrict_to_visible(&mut self, cam: &CameraFromWorld) {
        self.seen = self.given.visible_from(cam);
    }

    /// Sets the camera for refinement, relative to the given one.
    pub(super) fn set_camera(&mut self, change: &CameraChange) {
        let matches = self.seen.with_camera(change.pinhole(&self.seen.camera));
        self.kernel = Kernel::new(&matches, Scale::Likelihood { noise: self.rigid_noise });
        self.matches = matches;
    }

    /// The correspondences, with the camera of the search or refinement.
    pub(crate) const fn matches(&self) -> &Matches<'a> {
        &self.matches
    }

    /// The correspondences, ready to be scored.
    pub(super) const fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    pub(super) const fn priors(&self) -> &PosePriors {
        &self.priors
    }

    /// How well the focal length is known.
    pub(super) const fn focal(&self) -> FocalPrior {
        self.problem.focal
    }

    /// The given camera.
    pub(super) const fn camera(&self) -> &veiloc_geometry::Pinhole {
        &self.seen.camera
    }

    pub(super) fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<CameraFromWorld>) {
        self.minimal.hypothesize(&self.matches, rng, models);
    }

    /// Probability that a sample agrees with a pose.
    pub(super) fn hit_probability(&self, cam: &CameraFromWorld) -> f64 {
        let agreeing = agreeing(&self.kernel.likelihoods(cam, self.rigid_noise));
        self.minimal.hit_probability(&self.matches, &agreeing)
    }

    /// Adds the camera priors.
    pub(super) fn with_prior_terms(&self, cam: &CameraFromWorld, mut system: System) -> System {
        self.priors.add_to(cam, &mut system);
        system
    }

    /// Gain of a pose by this frame's matches at the camera pose given by the odometry; 0 or less when less than
    /// `least`.
    pub(super) fn rigid_gain(&self, cam: &CameraFromWorld, least: f64) -> f64 {
        -self.kernel.cost(cam, -least)
    }

    /// What a pose gains too much by matches that it cannot see.
    pub(super) fn unseen_gain(&self, cam: &CameraFromWorld, noise: f64) -> f64 {
        let unseen = |(i, llr): (usize, f64)| {
            if llr > 0.0 { llr - (llr + self.matches.visibility(i, cam).ln()).max(0.0) } else { 0.0 }
        };
        self.kernel.likelihoods(cam, noise).into_iter().enumerate().map(unseen).sum()
    }

    /// Correspondences that may be right at a pose.
    pub(super) fn possible(&self, cam: &CameraFromWorld, noise: f64) -> Vec<usize> {
        let all = self.kernel.likelihoods(cam, noise);
        (0..all.len()).filter(|&i| all[i] > MIN_LOG_LIKELIHOOD_RATIO).collect()
    }

    /// Variance of errors that neighbouring matches share at a pose, in multiples of that of independent ones.
    pub(super) fn design_effect(&self, cam: &CameraFromWorld, likelihoods: &[f64], noise: f64) -> f64 {
        let mut cells = ScoreCells::new(&self.matches.camera);
        let noise = self.matches.at_noise(noise);
        for i in (0..likelihoods.len()).filter(|&i| likelihoods[i] > MIN_LOG_LIKELIHOOD_RATIO) {
            if let Some(residual) = self.matches.residual(i, cam, true) {
                let score = residual.score(&self.matches.likelihood_term(i, &residual, &noise));
                cells.add(&residual.pixel, &score);
            }
        }
        cells.design_effect()
    }

    /// The objective with camera parameters, near a pose with this noise.
    pub(super) fn objective(&self, cam: &CameraFromWorld, noise: f64) -> Objective<'_> {
        Objective { matches: &self.seen, priors: &self.priors, active: self.possible(cam, noise), noise }
    }

    /// The same to test the camera.
    pub(super) fn camera_objective(&self, cam: &CameraFromWorld, noise: f64) -> CameraObjective<'_> {
        let (map, known) = (self.problem.map_cameras, self.problem.focal);
        CameraObjective { objective: self.objective(cam, noise), map, known }
    }
}

/// Correspondences that are likelier right than wrong.
pub(super) fn agreeing(likelihoods: &[f64]) -> Vec<usize> {
    (0..likelihoods.len()).filter(|&i| likelihoods[i] > 0.0).collect()
}

/// An upper bound of the gain of any pose at this noise.
fn max_gain(matches: &Matches<'_>, noise: f64) -> f64 {
    let log_farthest = match matches.observations {
        Correspondences::Anchored { pencils, .. } => {
            pencils.anchors().map(|a| log_farthest(matches, pencils, a)).fold(f64::NEG_INFINITY, f64::max)
        }
        Correspondences::Points { .. } | Correspondences::Lines { .. } => 0.0,
    };
    let extra = matches.noise_term(noise) + log_farthest;
    matches.log_likelihood_const.iter().map(|score_offset| (score_offset + extra).max(0.0)).sum()
}
