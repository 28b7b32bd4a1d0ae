//! The search: hypotheses from each frame, transferred to the rig by its odometry, scored on all frames.

use rand::Rng;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::OdometryConstraint;
use super::polish::polish_with_priors;
use crate::confidence::ambiguity::margin;
use crate::likelihood::{CameraChange, PosePriors, PoseProblem, Symmetric6};
use crate::options::PoseOptions;
use crate::ransac::sampler::WeightedSampler;
use crate::ransac::{Budget, Estimator, RansacResult, Stop, lo_ransac};

/// Shrinking scales of local optimisation, in multiples of the final one.
pub(crate) const LADDER: [f64; 3] = [4.0, 2.0, 1.0];

/// Steps at each scale.
pub(crate) const LADDER_STEPS: usize = 4;

/// A step of local optimisation that gains less than this share ends it.
const COARSE_GAIN: f64 = 1e-4;

/// Gain of a frame above which further gain is saturated, natural logarithm: several agreeing frames outvote one that
/// contradicts them, regardless of its number of matches. A pose with this gain in one frame is hardly chance. The gain of
/// a single frame is not saturated.
const SATURATION_GAIN: f64 = 100.0;

/// Share of the samples that is distributed evenly over all frames.
const UNIFORM_SHARE: f64 = 0.2;

/// All frames of a rig, prepared for the search.
pub(super) struct Search<'a> {
    /// `[F]`, those with correspondences.
    pub(super) frames: Vec<Frame<'a>>,
    /// `[F]`
    pub(super) constraints: Vec<OdometryConstraint>,
    noise: f64,
    draws: WeightedSampler,
    /// Probability that a sample is drawn from each frame, `[F]`.
    chances: Vec<f64>,
    /// Frames by falling upper bound of their gain, each with the sum of the bounds after it.
    order: Vec<(usize, f64)>,
    /// Optimised poses recorded during the search, with their costs by the matches and the odometry alone.
    optima: Vec<(RigFromWorld, f64)>,
    models: Vec<CameraFromWorld>,
    stop: Stop,
}

impl<'a> Search<'a> {
    /// `None` when no frame can be drawn from.
    pub(super) fn new(
        frames: Vec<Frame<'a>>,
        constraints: Vec<OdometryConstraint>,
        options: &PoseOptions,
    ) -> Option<Self> {
        let drawn = frames.iter().filter(|f| f.promise > 0.0).count() as f64;
        let total: f64 = frames.iter().map(|f| f.promise).sum();
        if !(total > 0.0) {
            return None;
        }
        let chance = |f: &Frame<'_>| {
            if f.promise > 0.0 {
                UNIFORM_SHARE / drawn + (1.0 - UNIFORM_SHARE) * f.promise / total
            } else {
                0.0
            }
        };
        let chances: Vec<f64> = frames.iter().map(chance).collect();
        let drawable = chances.iter().copied().enumerate().filter(|(_, chance)| *chance > 0.0);
        let draws = WeightedSampler::new(drawable);
        let mut order: Vec<usize> = (0..frames.len()).collect();
        order.sort_by(|&i, &j| frames[j].promise.total_cmp(&frames[i].promise));
        let mut search = Self {
            frames,
            constraints,
            noise: options.noise_px,
            draws,
            chances,
            order: Vec::new(),
            optima: Vec::new(),
            models: Vec::new(),
            stop: options.stop.clone(),
        };
        let mut rest = 0.0;
        for i in order.into_iter().rev() {
            search.order.push((i, rest));
            rest += search.saturated(search.frames[i].most);
        }
        search.order.reverse();
        Some(search)
    }

    /// The saturated gain of a frame.
    fn saturated(&self, gain: f64) -> f64 {
        if self.frames.len() == 1 {
            gain
        } else {
            SATURATION_GAIN * (gain.max(0.0) / SATURATION_GAIN).ln_1p()
        }
    }

    /// The gain with this saturated value.
    fn inverse_saturated(&self, saturated: f64) -> f64 {
        if self.frames.len() == 1 {
            saturated
        } else {
            SATURATION_GAIN * (saturated / SATURATION_GAIN).exp_m1()
        }
    }

    /// Searches with the camera priors, and then without them: a wrong prior would hide the pose, or other poses that the
    /// matches explain as well. The search keeps the priors.
    pub(super) fn run<R: Rng + ?Sized>(
        &mut self,
        mut budget: Budget,
        options: &PoseOptions,
        rng: &mut R,
    ) -> RansacResult<Poses> {
        self.use_all_priors(options);
        if self.frames.iter().all(|frame| frame.priors().is_empty()) {
            return lo_ransac(self, &budget, rng);
        }
        if options.fixed_hypotheses.is_some() {
            budget = Budget::fixed(budget.max.div_ceil(2));
        }
        let mut found = lo_ransac(self, &budget, rng);
        self.use_priors(options, |_| PosePriors::default());
        let alone = lo_ransac(self, &budget, rng);
        self.use_all_priors(options);
        let cost = alone.model.as_ref().map_or(f64::INFINITY, |at| alone.cost + self.prior_loss(&at.cams));
        if cost < found.cost {
            (found.model, found.cost) = (alone.model, cost);
        }
        found.samples += alone.samples;
        found
    }

    /// Uses all camera priors of the frames.
    pub(super) fn use_all_priors(&mut self, options: &PoseOptions) {
        self.use_priors(options, PosePriors::of);
    }

    fn use_priors(&mut self, options: &PoseOptions, of: impl Fn(&PoseProblem) -> PosePriors) {
        for frame in &mut self.frames {
            frame.use_priors(of(frame.problem), options);
        }
    }

    /// Sets the camera of these frames for refinement, relative to the given one.
    pub(super) fn set_camera(&mut self, frames: &[usize], change: &CameraChange) {
        for &i in frames {
            self.frames[i].set_camera(change);
        }
    }

    /// Minus the log likelihood of the poses against "all matches are wrong", after the search, without saturation of
    /// the frames' gains.
    pub(super) fn raw_cost(&self, poses: &Poses) -> f64 {
        let of = |(frame, cam): (&Frame<'_>, &CameraFromWorld)| frame.kernel().cost_at(cam, self.noise);
        let matches: f64 = self.frames.iter().zip(&poses.cams).map(of).sum();
        poses.odometry_loss(&self.constraints) + self.prior_loss(&poses.cams) + matches
    }

    /// Refines at scales that shrink to the final one.
    pub(super) fn descend(&self, start: &Poses) -> Poses {
        let mut poses = start.clone();
        for factor in LADDER {
            let objective = |i: usize, cam: &CameraFromWorld| {
                let frame = &self.frames[i];
                let noise = self.ladder_noise(frame, factor);
                frame.with_prior_terms(cam, frame.kernel().linearize_coarsely(cam, noise))
            };
            poses = descend(&self.constraints, objective, &poses, LADDER_STEPS, COARSE_GAIN);
        }
        poses
    }

    /// Loss of the poses under the camera priors.
    pub(super) fn prior_loss(&self, cams: &[CameraFromWorld]) -> f64 {
        self.frames.iter().zip(cams).map(|(frame, cam)| frame.priors().loss(cam)).sum()
    }

    /// The joint cost after a descent, lower is better: odometry loss plus prior loss minus the saturated gains.
    pub(super) fn settled_cost(&self, poses: &Poses) -> f64 {
        self.cost_of(poses, |frame, cam| -frame.kernel().cost_at(cam, self.noise))
    }

    fn cost_of(&self, poses: &Poses, gain: impl Fn(&Frame<'_>, &CameraFromWorld) -> f64) -> f64 {
        let gains = self.frames.iter().zip(&poses.cams).map(|(frame, cam)| self.saturated(gain(frame, cam)));
        poses.odometry_loss(&self.constraints) + self.prior_loss(&poses.cams) - gains.sum::<f64>()
    }

    /// The margin of the poses over the best other optimum; infinite when there is none. Only after the search. Optima
    /// with a margin below `least` are refined first.
    pub(super) fn margin(
        &self,
        poses: &Poses,
        covariance: &Symmetric6,
        least: f64,
        options: &PoseOptions,
    ) -> f64 {
        let own = self.settled_cost(poses) - self.prior_loss(&poses.cams);
        let refined = |rig: &RigFromWorld| {
            let start = Poses::rigid(&self.constraints, *rig);
            polish_with_priors(false, &self.frames, &self.constraints, &start, options).poses.rig
        };
        margin(&self.optima, &poses.rig, own, covariance, least, refined)
    }

    /// Noise of a frame's matches at a scale of the local optimisation, which also covers the odometry's noise.
    fn ladder_noise(&self, frame: &Frame<'_>, factor: f64) -> f64 {
        let from = frame.rigid_noise * (factor - 1.0) / (LADDER[0] - 1.0);
        (self.noise * factor).max(from)
    }
}

impl Estimator for Search<'_> {
    type Model = Poses;

    fn is_stopped(&self) -> bool {
        self.stop.is_set()
    }

    fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<Poses>) {
        // A rig of one frame draws the same random numbers as that frame alone.
        let frame = if self.draws.len() == 1 {
            self.chances.iter().position(|chance| *chance > 0.0)
        } else {
            self.draws.draw(rng)
        };
        let Some(frame) = frame else { return };
        self.models.clear();
        self.frames[frame].hypothesize(rng, &mut self.models);
        models.extend(
            self.models.iter().map(|cam| Poses::rigid(&self.constraints, self.constraints[frame].rig(cam))),
        );
    }

    fn cost(&self, model: &Poses, best: f64) -> f64 {
        let mut sum = -self.prior_loss(&model.cams);
        for &(i, rest) in &self.order {
            let least = self.inverse_saturated((-best - sum - rest).max(0.0));
            sum += self.saturated(self.frames[i].rigid_gain(&model.cams[i], least));
            if sum + rest < -best {
                return f64::INFINITY;
            }
        }
        -sum
    }

    fn hit_probability(&self, model: &Poses) -> f64 {
        let of = |((frame, cam), chance): ((&Frame<'_>, &CameraFromWorld), &f64)| {
            if *chance > 0.0 { chance * frame.hit_probability(cam) } else { 0.0 }
        };
        self.frames.iter().zip(&model.cams).zip(&self.chances).map(of).sum()
    }

    fn optimize<R: Rng + ?Sized>(&mut self, model: &Poses, _cost: f64, _rng: &mut R) -> (Poses, f64) {
        let poses = self.descend(model);
        let is_better = self.settled_cost(&poses) < self.settled_cost(model);
        let best = if is_better { poses } else { model.clone() };
        let gain = |frame: &Frame<'_>, cam: &CameraFromWorld| {
            -frame.kernel().cost_at(cam, self.noise) - frame.unseen_gain(cam, self.noise)
        };
        let cost = self.cost_of(&best, gain);
        self.optima.push((best.rig, cost - self.prior_loss(&best.cams)));
        (best, cost)
    }
}
