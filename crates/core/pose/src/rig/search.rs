//! The search for a rig: hypotheses from each frame, transferred to the rig by its odometry, scored on all frames.

use rand::Rng;
use veiloc_geometry::deviations::position_sd;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::OdometryConstraint;
use super::polish::polish_with_priors;
use crate::ambiguity::margin;
use crate::likelihood::Symmetric6;
use crate::options::PoseOptions;
use crate::ransac::Estimator;
use crate::ransac::Stop;
use crate::ransac::sampler::WeightedSampler;
use crate::ransac::search::{COARSE_GAIN, LADDER, LADDER_STEPS};

/// Gain of a frame above which further gain is saturated, natural logarithm: several agreeing frames outvote one that
/// contradicts them, regardless of its number of matches. A pose with this gain in one frame is hardly chance.
const SATURATION_GAIN: f64 = 100.0;

/// Share of the samples that is distributed evenly over all frames.
const UNIFORM_SHARE: f64 = 0.2;

/// All frames of a rig, prepared for the search.
pub(super) struct RigSearch<'a> {
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

/// The saturated gain of a frame.
fn saturated(gain: f64) -> f64 {
    SATURATION_GAIN * (gain.max(0.0) / SATURATION_GAIN).ln_1p()
}

/// The gain with this saturated value.
fn inverse_saturated(saturated: f64) -> f64 {
    SATURATION_GAIN * (saturated / SATURATION_GAIN).exp_m1()
}

impl<'a> RigSearch<'a> {
    /// `None` when no frame can be drawn from.
    pub(super) fn new(
        frames: Vec<Frame<'a>>,
        constraints: Vec<OdometryConstraint>,
        noise: f64,
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
        let mut rest = 0.0;
        let mut order: Vec<(usize, f64)> = order
            .into_iter()
            .rev()
            .map(|i| {
                let after = rest;
                rest += saturated(frames[i].most);
                (i, after)
            })
            .collect();
        order.reverse();
        Some(Self {
            frames,
            constraints,
            noise,
            draws,
            chances,
            order,
            optima: Vec::new(),
            models: Vec::new(),
            stop: Stop::default(),
        })
    }

    /// This search with a stop flag.
    pub(super) fn with_stop(mut self, stop: &Stop) -> Self {
        self.stop = stop.clone();
        self
    }

    /// Sets the focal length of these frames for refinement, relative to the given one.
    pub(super) fn set_focal(&mut self, frames: &[usize], factor: f64) {
        for &i in frames {
            self.frames[i].set_focal(factor);
        }
    }

    /// Largest distance of a frame from the position given for it, in standard deviations; `None` without one.
    pub(super) fn position_deviation(
        &self,
        cams: &[CameraFromWorld],
        covariance: &Symmetric6,
    ) -> Option<f64> {
        let sd = position_sd(covariance);
        let of =
            |(frame, cam): (&Frame<'_>, &CameraFromWorld)| frame.search.priors().position_deviation(cam, sd);
        self.frames.iter().zip(cams).filter_map(of).reduce(f64::max)
    }

    /// Minus the log likelihood of the poses against "all matches are wrong", after the search, without saturation of
    /// the frames' gains.
    pub(super) fn raw_cost(&self, poses: &Poses) -> f64 {
        let of =
            |(frame, cam): (&Frame<'_>, &CameraFromWorld)| frame.search.kernel().cost_at(cam, self.noise);
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
                frame.with_prior_terms(cam, frame.search.kernel().linearize_coarsely(cam, noise))
            };
            poses = descend(&self.constraints, objective, &poses, LADDER_STEPS, COARSE_GAIN);
        }
        poses
    }

    /// Loss of the poses under the camera priors.
    pub(super) fn prior_loss(&self, cams: &[CameraFromWorld]) -> f64 {
        self.frames.iter().zip(cams).map(|(frame, cam)| frame.search.priors().loss(cam)).sum()
    }

    /// Odometry loss plus prior loss minus the gain of all frames.
    fn joint_cost(&self, poses: &Poses, gain: impl Fn(&Frame<'_>, &CameraFromWorld) -> f64) -> f64 {
        let gains = self.frames.iter().zip(&poses.cams).map(|(frame, cam)| saturated(gain(frame, cam)));
        poses.odometry_loss(&self.constraints) + self.prior_loss(&poses.cams) - gains.sum::<f64>()
    }

    /// The joint cost after the search.
    pub(super) fn settled_cost(&self, poses: &Poses) -> f64 {
        self.joint_cost(poses, |frame, cam| -frame.search.kernel().cost_at(cam, self.noise))
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

impl Estimator for RigSearch<'_> {
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
        self.frames[frame].search.hypothesize(rng, &mut self.models);
        models.extend(
            self.models.iter().map(|cam| Poses::rigid(&self.constraints, self.constraints[frame].rig(cam))),
        );
    }

    fn cost(&self, model: &Poses, best: f64) -> f64 {
        let mut sum = -self.prior_loss(&model.cams);
        for &(i, rest) in &self.order {
            let least = inverse_saturated((-best - sum - rest).max(0.0));
            sum += saturated(self.frames[i].rigid_gain(&model.cams[i], least));
            if sum + rest < -best {
                return f64::INFINITY;
            }
        }
        -sum
    }

    fn hit_probability(&self, model: &Poses) -> f64 {
        let of = |((frame, cam), chance): ((&Frame<'_>, &CameraFromWorld), &f64)| {
            if *chance > 0.0 { chance * frame.search.hit_probability(cam) } else { 0.0 }
        };
        self.frames.iter().zip(&model.cams).zip(&self.chances).map(of).sum()
    }

    fn optimize<R: Rng + ?Sized>(&mut self, model: &Poses, _cost: f64, _rng: &mut R) -> (Poses, f64) {
        let poses = self.descend(model);
        let cost = |poses: &Poses| self.joint_cost(poses, |frame, cam| frame.gain_as_seen(cam, self.noise));
        let (before, after) = (cost(model), cost(&poses));
        let best = if after < before { (poses, after) } else { (model.clone(), before) };
        self.optima.push((best.0.rig, best.1 - self.prior_loss(&best.0.cams)));
        best
    }
}
