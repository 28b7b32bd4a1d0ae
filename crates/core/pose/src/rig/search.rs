//! The search for a rig: hypotheses from each frame, carried to the rig by its odometry, scored on all frames.

use rand::Rng;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::frame::Frame;
use super::joint::{Poses, descend};
use super::odometry::Tie;
use super::polish::polish_knowing;
use crate::ambiguity::margin;
use crate::likelihood::Symmetric6;
use crate::options::PoseOptions;
use crate::ransac::Estimator;
use crate::ransac::Stop;
use crate::ransac::sampler::WeightedSampler;
use crate::ransac::search::{COARSE_GAIN, LADDER, LADDER_STEPS};

/// Gain of a frame from which on more of it counts less, natural logarithm: many frames that agree outvote one that
/// contradicts them, however many matches that one has. A pose with this gain in one frame is hardly chance.
const PLENTY: f64 = 100.0;

/// Share of the samples that all frames have alike, whatever they promise.
const ALIKE: f64 = 0.2;

/// All frames of a rig, ready to be searched.
pub(super) struct RigSearch<'a> {
    /// `[F]`, those that show something.
    pub(super) frames: Vec<Frame<'a>>,
    /// `[F]`
    pub(super) ties: Vec<Tie>,
    noise: f64,
    draws: WeightedSampler,
    /// Chance that a sample is of each frame, `[F]`.
    chances: Vec<f64>,
    /// Frames by what they promise, most first, each with what those after it gain at most.
    order: Vec<(usize, f64)>,
    /// Optimised poses met on the way, with their costs by the matches and the odometry alone.
    optima: Vec<(RigFromWorld, f64)>,
    models: Vec<CameraFromWorld>,
    stop: Stop,
}

/// What a frame's gain counts for.
fn counted(gain: f64) -> f64 {
    PLENTY * (gain.max(0.0) / PLENTY).ln_1p()
}

/// The gain that counts for so much.
fn gain_of(counted: f64) -> f64 {
    PLENTY * (counted / PLENTY).exp_m1()
}

impl<'a> RigSearch<'a> {
    /// `None` when no frame can be drawn from.
    pub(super) fn new(frames: Vec<Frame<'a>>, ties: Vec<Tie>, noise: f64) -> Option<Self> {
        let drawn = frames.iter().filter(|f| f.promise > 0.0).count() as f64;
        let total: f64 = frames.iter().map(|f| f.promise).sum();
        if !(total > 0.0) {
            return None;
        }
        let chance = |f: &Frame<'_>| {
            if f.promise > 0.0 { ALIKE / drawn + (1.0 - ALIKE) * f.promise / total } else { 0.0 }
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
                rest += counted(frames[i].most);
                (i, after)
            })
            .collect();
        order.reverse();
        Some(Self {
            frames,
            ties,
            noise,
            draws,
            chances,
            order,
            optima: Vec::new(),
            models: Vec::new(),
            stop: Stop::default(),
        })
    }

    /// The same, given up once this is set.
    pub(super) fn until(mut self, stop: &Stop) -> Self {
        self.stop = stop.clone();
        self
    }

    /// What is left to do is done with a focal length of these frames so many times the given one.
    pub(super) fn zoom(&mut self, frames: &[usize], factor: f64) {
        for &i in frames {
            self.frames[i].zoom(factor);
        }
    }

    /// Minus the log likelihood of the poses against "all matches are wrong", once the search is settled: what no frame's
    /// gain counts less in.
    pub(super) fn raw_cost(&self, poses: &Poses) -> f64 {
        let of =
            |(frame, cam): (&Frame<'_>, &CameraFromWorld)| frame.search.kernel().cost_at(cam, self.noise);
        let matches: f64 = self.frames.iter().zip(&poses.cams).map(of).sum();
        poses.tension(&self.ties) + self.disbelief(&poses.cams) + matches
    }

    /// Refines at scales that shrink to the final one.
    pub(super) fn descend(&self, start: &Poses) -> Poses {
        let mut poses = start.clone();
        for factor in LADDER {
            let objective = |i: usize, cam: &CameraFromWorld| {
                let frame = &self.frames[i];
                let noise = self.ladder_noise(frame, factor);
                frame.believed(cam, frame.search.kernel().linearize_coarsely(cam, noise))
            };
            poses = descend(&self.ties, objective, &poses, LADDER_STEPS, COARSE_GAIN);
        }
        poses
    }

    /// What the poses cost in what is known beside the matches.
    pub(super) fn disbelief(&self, cams: &[CameraFromWorld]) -> f64 {
        self.frames.iter().zip(cams).map(|(frame, cam)| frame.search.priors().loss(cam)).sum()
    }

    /// What the poses strain the odometry and contradict what is known, less what they gain by all frames.
    fn joint_cost(&self, poses: &Poses, gain: impl Fn(&Frame<'_>, &CameraFromWorld) -> f64) -> f64 {
        let gains = self.frames.iter().zip(&poses.cams).map(|(frame, cam)| counted(gain(frame, cam)));
        poses.tension(&self.ties) + self.disbelief(&poses.cams) - gains.sum::<f64>()
    }

    /// The joint cost once the search is settled.
    pub(super) fn settled_cost(&self, poses: &Poses) -> f64 {
        self.joint_cost(poses, |frame, cam| -frame.search.kernel().cost_at(cam, self.noise))
    }

    /// By how much the poses beat the best optimum that was met elsewhere; infinite when none was. The search must have
    /// been settled. Optima that come closer than `least` are refined first.
    pub(super) fn margin(
        &self,
        poses: &Poses,
        covariance: &Symmetric6,
        least: f64,
        options: &PoseOptions,
    ) -> f64 {
        let own = self.settled_cost(poses) - self.disbelief(&poses.cams);
        let refined = |rig: &RigFromWorld| {
            let start = Poses::rigid(&self.ties, *rig);
            polish_knowing(false, &self.frames, &self.ties, &start, options).poses.rig
        };
        margin(&self.optima, &poses.rig, own, covariance, least, refined)
    }

    /// Noise of a frame's matches at a step of the ladder: what the odometry adds is descended into as well.
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
        // A rig of one frame draws just as that frame alone does.
        let frame = if self.draws.len() == 1 {
            self.chances.iter().position(|chance| *chance > 0.0)
        } else {
            self.draws.draw(rng)
        };
        let Some(frame) = frame else { return };
        self.models.clear();
        self.frames[frame].search.hypothesize(rng, &mut self.models);
        models.extend(self.models.iter().map(|cam| Poses::rigid(&self.ties, self.ties[frame].rig(cam))));
    }

    fn cost(&self, model: &Poses, best: f64) -> f64 {
        let mut sum = -self.disbelief(&model.cams);
        for &(i, rest) in &self.order {
            let least = gain_of((-best - sum - rest).max(0.0));
            sum += counted(self.frames[i].rigid_gain(&model.cams[i], least));
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
        self.optima.push((best.0.rig, best.1 - self.disbelief(&best.0.cams)));
        best
    }
}
