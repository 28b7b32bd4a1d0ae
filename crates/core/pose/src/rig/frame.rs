//! One frame of a rig, ready to be searched.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::statistics::upper_median;

use super::RigFrame;
use crate::error::PoseError;
use crate::likelihood::{
    Correspondences, FocalKnowledge, Matches, PosePriors, Scale, System, log_farthest, median_point,
};
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::ransac::minimal::Minimal;
use crate::ransac::sampler::WeightedSampler;
use crate::ransac::search::Search;

/// A frame that shows something.
pub(super) struct Frame<'a> {
    /// Its place in the list of the caller.
    pub(super) index: usize,
    /// Its correspondences with the focal length as given.
    pub(super) given: &'a Matches<'a>,
    /// The same as the best pose sees them, once there is one.
    pub(super) seen: Matches<'a>,
    /// How well its focal length is known.
    pub(super) focal: FocalKnowledge,
    pub(super) search: Search<'a>,
    /// Noise of the matches where the odometry puts the camera: their own and the odometry's together, pixels.
    pub(super) rigid_noise: f64,
    /// No pose gains more than this at that noise.
    pub(super) most: f64,
    /// How likely a sample of it is right; 0 when it cannot be drawn from.
    pub(super) promise: f64,
}

/// Whether the problem of a frame can be drawn from; an error when it is wrong rather than poor.
pub(super) fn stands_alone(problem: &crate::PoseProblem) -> Result<bool, PoseError> {
    match problem.check() {
        Ok(()) => Ok(true),
        Err(PoseError::TooFew { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Size of what is seen, map units: how far cameras usually are from it.
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
    /// `zoomed` are the correspondences with the focal length that is searched with, `given` those with the given one.
    pub(super) fn new(
        index: usize,
        frame: &RigFrame,
        given: &'a Matches<'a>,
        matches: &'a Matches<'a>,
        stands_alone: bool,
        options: &PoseOptions,
    ) -> Self {
        let focal = f64::midpoint(matches.camera.focal[0], matches.camera.focal[1]);
        let shift = frame.translation_sd / scene_size(matches, frame);
        let by_odometry =
            focal * frame.rotation_sd_deg.to_radians().hypot(if shift.is_finite() { shift } else { 0.0 });
        let rigid_noise = options.noise_px.hypot(by_odometry);
        let solver = options.anchored_solver.unwrap_or(AnchoredSolver::default_for(ScoreKind::Likelihood));
        // By the matches alone: gravity that is wrong would hide the pose, or poses that the matches explain as well.
        let minimal = Minimal::new(matches, solver, None, options.noise_px);
        let priors = PosePriors::of(&frame.problem);
        let all = WeightedSampler::new(matches.weight.iter().copied().enumerate());
        let promise =
            all.expected_share().powi(i32::try_from(matches.observations.sample_size()).unwrap_or(i32::MAX));
        Self {
            index,
            given,
            seen: given.clone(),
            focal: frame.problem.focal,
            search: Search::new(matches, Scale::Likelihood { noise: rigid_noise }, minimal, priors),
            rigid_noise,
            most: most_gain(matches, rigid_noise),
            promise: if stands_alone { promise } else { 0.0 },
        }
    }

    /// From here on correspondences are worth what one pose can see of them.
    pub(super) fn see_from(&mut self, cam: &CameraFromWorld) {
        self.seen = self.given.as_seen_from(cam);
    }

    /// What is left to do is done with a focal length so many times the given one: nothing is sampled any more.
    pub(super) fn zoom(&mut self, factor: f64) {
        self.search.fix_visible(self.seen.with_focal(factor));
    }

    /// Adds what is known of the camera beside its matches.
    pub(super) fn believed(&self, cam: &CameraFromWorld, mut system: System) -> System {
        self.search.priors().add_to(cam, &mut system);
        system
    }

    /// What a pose gains by this frame's matches where the odometry puts its camera; 0 or less when less than `least`.
    pub(super) fn rigid_gain(&self, cam: &CameraFromWorld, least: f64) -> f64 {
        -self.search.kernel().cost(cam, -least)
    }

    /// What a pose gains by this frame's matches, as far as it can have seen what they say.
    pub(super) fn gain_as_seen(&self, cam: &CameraFromWorld, noise: f64) -> f64 {
        let matches = self.search.matches();
        let likelihoods = self.search.kernel().likelihoods(cam, noise);
        let seen = |(i, llr): (usize, f64)| {
            if llr > 0.0 { (llr + matches.visibility(i, cam).ln()).max(0.0) } else { 0.0 }
        };
        likelihoods.into_iter().enumerate().map(seen).sum()
    }
}

/// An upper bound of what any pose gains at this noise.
fn most_gain(matches: &Matches<'_>, noise: f64) -> f64 {
    let log_farthest = match matches.observations {
        Correspondences::Anchored { pencils, .. } => {
            pencils.anchors().map(|a| log_farthest(matches, pencils, a)).fold(f64::NEG_INFINITY, f64::max)
        }
        Correspondences::Points { .. } | Correspondences::Lines { .. } => 0.0,
    };
    let extra = matches.noise_term(noise) + log_farthest;
    matches.log_likelihood_const.iter().map(|worth| (worth + extra).max(0.0)).sum()
}
