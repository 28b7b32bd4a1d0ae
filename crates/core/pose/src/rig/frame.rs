//! One frame of a rig, prepared for the search.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::statistics::upper_median;

use super::RigFrame;
use crate::error::PoseError;
use crate::likelihood::{
    CameraObjective, Correspondences, FocalPrior, Matches, PosePriors, Scale, System, log_farthest,
    median_point,
};
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::ransac::minimal::Minimal;
use crate::ransac::sampler::WeightedSampler;
use crate::ransac::search::Search;

/// A frame with correspondences.
pub(super) struct Frame<'a> {
    /// Its index in the caller's list.
    pub(super) index: usize,
    /// Its correspondences with the given focal length.
    pub(super) given: &'a Matches<'a>,
    /// The same as the best pose sees them, once there is one.
    pub(super) seen: Matches<'a>,
    /// How well its focal length is known.
    pub(super) focal: FocalPrior,
    pub(super) search: Search<'a>,
    /// Noise of the matches at the camera pose given by the odometry: their own and the odometry's together, pixels.
    pub(super) rigid_noise: f64,
    /// Upper bound of any pose's gain at that noise.
    pub(super) most: f64,
    /// Probability that a sample is right; 0 when it cannot be drawn from.
    pub(super) promise: f64,
}

/// Whether the frame has enough correspondences for a hypothesis; an error when its problem is invalid.
pub(super) fn has_minimal_sample(problem: &crate::PoseProblem) -> Result<bool, PoseError> {
    match problem.check() {
        Ok(()) => Ok(true),
        Err(PoseError::TooFew { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Size of the scene, map units: the typical distance of cameras from it.
pub(super) fn scene_size(matches: &Matches<'_>, frame: &RigFrame) -> f64 {
    let mut distances: Vec<f64> = if let Some(seen_from) = &frame.problem.seen_from {
        matches.points.iter().zip(seen_from).map(|(p, s)| (p - s.center.coords).norm()).collect()
    } else {
        let center = median_point(&matches.points);
        matches.points.iter().map(|p| (p - center).norm()).collect()
    };
    upper_median(&mut distances).unwrap_or(f64::NAN)
}

impl<'a> Frame<'a> {
    /// The objective with the camera as parameters, near a pose with this noise. `given` are the frames as the caller gave
    /// them.
    pub(super) fn camera_objective(
        &self,
        given: &[RigFrame],
        pose: &CameraFromWorld,
        noise: f64,
    ) -> CameraObjective<'_> {
        CameraObjective {
            matches: &self.seen,
            priors: self.search.priors(),
            active: self.search.possible(pose, noise),
            noise,
            map: given[self.index].problem.map_cameras,
            known: self.focal,
        }
    }

    /// `zoomed` are the correspondences with the focal length of the search, `given` those with the given one.
    pub(super) fn new(
        index: usize,
        frame: &RigFrame,
        given: &'a Matches<'a>,
        matches: &'a Matches<'a>,
        has_minimal_sample: bool,
        options: &PoseOptions,
    ) -> Self {
        let focal = f64::midpoint(matches.camera.focal[0], matches.camera.focal[1]);
        let shift = frame.translation_sd / scene_size(matches, frame);
        let by_odometry =
            focal * frame.rotation_sd_deg.to_radians().hypot(if shift.is_finite() { shift } else { 0.0 });
        let rigid_noise = options.noise_px.hypot(by_odometry);
        let solver = options.anchored_solver.unwrap_or(AnchoredSolver::default_for(ScoreKind::Likelihood));
        // By the matches alone: wrong gravity would hide the pose, or poses that the matches explain as well.
        let minimal = Minimal::new(matches, solver, None, options.noise_px);
        let priors = PosePriors::of(&frame.problem);
        let all = WeightedSampler::new(matches.inlier_prior.iter().copied().enumerate());
        let promise =
            all.expected_share().powi(i32::try_from(matches.observations.sample_size()).unwrap_or(i32::MAX));
        Self {
            index,
            given,
            seen: given.clone(),
            focal: frame.problem.focal,
            search: Search::new(matches, Scale::Likelihood { noise: rigid_noise }, minimal, priors),
            rigid_noise,
            most: max_gain(matches, rigid_noise),
            promise: if has_minimal_sample { promise } else { 0.0 },
        }
    }

    /// Restricts the correspondences to what this pose can see.
    pub(super) fn restrict_to_visible(&mut self, cam: &CameraFromWorld) {
        self.seen = self.given.visible_from(cam);
    }

    /// Sets the focal length for refinement, relative to the given one; sampling ends.
    pub(super) fn set_focal(&mut self, factor: f64) {
        self.search.fix_visible(self.seen.with_focal(factor));
    }

    /// Adds the camera priors.
    pub(super) fn with_prior_terms(&self, cam: &CameraFromWorld, mut system: System) -> System {
        self.search.priors().add_to(cam, &mut system);
        system
    }

    /// Gain of a pose by this frame's matches at the camera pose given by the odometry; 0 or less when less than
    /// `least`.
    pub(super) fn rigid_gain(&self, cam: &CameraFromWorld, least: f64) -> f64 {
        -self.search.kernel().cost(cam, -least)
    }

    /// Gain of a pose by this frame's matches, as far as the pose can see them.
    pub(super) fn gain_as_seen(&self, cam: &CameraFromWorld, noise: f64) -> f64 {
        let matches = self.search.matches();
        let likelihoods = self.search.kernel().likelihoods(cam, noise);
        let seen = |(i, llr): (usize, f64)| {
            if llr > 0.0 { (llr + matches.visibility(i, cam).ln()).max(0.0) } else { 0.0 }
        };
        likelihoods.into_iter().enumerate().map(seen).sum()
    }
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
