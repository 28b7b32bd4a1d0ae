//! What the search loop searches with: one problem under one score, its hypotheses, local optimisation and final polish.
//!
//! Under the likelihood everything minimises one objective, `−Σ log(1 + exp llr)`: local optimisation at shrinking
//! scales, the final refinement at the scale that the inliers show. Under MSAC it is the truncated square.

use std::borrow::Cow;

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix6, Vector3};

use crate::ambiguity::margin;
use crate::confidence::LEAST_MARGIN;
use crate::likelihood::{
    Estimated, Kernel, Loss, Matches, NEGLIGIBLE, PosePriors, Scale, Symmetric6, System, Zoomed, descend,
    inverse_or_infinite, linearize, refine,
};
use crate::ransac::Estimator;
use crate::ransac::Stop;
use crate::ransac::minimal::Minimal;

/// MSAC's threshold in multiples of the noise it stands for: the likelihood that its evidence is told by.
const MSAC_THRESHOLD_IN_NOISE: f64 = 2.5;

/// Shrinking scales of local optimisation, in multiples of the final one.
pub(crate) const LADDER: [f64; 3] = [4.0, 2.0, 1.0];

/// Steps at each scale.
pub(crate) const LADDER_STEPS: usize = 4;

/// A step of local optimisation that gains less than this share ends it.
pub(crate) const COARSE_GAIN: f64 = 1e-4;

/// Under MSAC, more correspondences than this are thinned out evenly in local optimisation.
const DESCENT_LIMIT: usize = 800;

/// Subsets of the inliers tried in local optimisation under MSAC, and their size.
const SUBSETS: usize = 8;
const SUBSET_SIZE: usize = 14;

/// Rounds of final refinement and noise estimation.
pub(crate) const POLISH_ROUNDS: usize = 12;

/// Steps of one round.
pub(crate) const ROUND_STEPS: usize = 3;

/// Range of the noise that the final refinement believes in, in multiples of the assumed one.
pub(crate) const NOISE_RANGE: [f64; 2] = [0.05, 1.5];

/// Steps of the last refinement, in double precision.
pub(crate) const FINAL_STEPS: usize = 25;

/// A step of it that gains less than this share ends it.
pub(crate) const FINAL_GAIN: f64 = 1e-9;

/// One problem under one score.
pub(crate) struct Search<'a> {
    matches: Cow<'a, Matches<'a>>,
    kernel: Kernel,
    scale: Scale,
    /// How hypotheses are made; none any more once a pose was found.
    minimal: Option<Minimal>,
    /// What is known beside the matches; nothing under MSAC, which is the paper's recipe.
    priors: PosePriors,
    /// Optimised poses met on the way, with their costs by the matches alone.
    optima: Vec<(CameraFromWorld, f64)>,
    stop: Stop,
}

/// A pose after the final refinement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polished {
    pub(crate) pose: CameraFromWorld,
    /// Scale of the likelihood's noise that the inliers show, pixels; under MSAC the threshold.
    pub(crate) noise: f64,
    /// Whether the refinement was kept.
    pub(crate) kept: bool,
}

impl<'a> Search<'a> {
    pub(crate) fn new(matches: &'a Matches<'a>, scale: Scale, minimal: Minimal, priors: PosePriors) -> Self {
        let kernel = Kernel::new(matches, scale);
        let (minimal, stop) = (Some(minimal), Stop::default());
        Self { matches: Cow::Borrowed(matches), kernel, scale, minimal, priors, optima: Vec::new(), stop }
    }

    /// The same, given up once this is set.
    pub(crate) fn until(mut self, stop: &Stop) -> Self {
        self.stop = stop.clone();
        self
    }

    /// The correspondences, ready to be scored.
    pub(crate) const fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// The cost of a pose from which not every correspondence can be seen; `cost` is that of seeing all.
    fn cost_as_seen(&self, pose: &CameraFromWorld, cost: f64) -> f64 {
        let Scale::Likelihood { noise } = self.scale else { return cost };
        let unseen = |(i, llr): (usize, f64)| {
            if llr > 0.0 { llr - (llr + self.matches.visibility(i, pose).ln()).max(0.0) } else { 0.0 }
        };
        cost + self.kernel.likelihoods(pose, noise).into_iter().enumerate().map(unseen).sum::<f64>()
    }

    /// What is left to do when a pose was found, over the correspondences as that pose sees them: nothing is sampled any
    /// more.
    pub(crate) fn fix_visible(&mut self, matches: Matches<'a>) {
        self.kernel = Kernel::new(&matches, self.scale);
        self.matches = Cow::Owned(matches);
        self.minimal = None;
    }

    /// Where the pose goes with another focal length, and the cost there.
    pub(crate) fn try_focal(
        &self,
        matches: Matches<'a>,
        pose: &CameraFromWorld,
        factor: f64,
    ) -> (Zoomed, f64) {
        let kernel = Kernel::new(&matches, self.scale);
        let probe = Search {
            matches: Cow::Owned(matches),
            kernel,
            scale: self.scale,
            minimal: None,
            priors: self.priors.clone(),
            optima: Vec::new(),
            stop: self.stop.clone(),
        };
        let pose = probe.descend(pose);
        (Zoomed { pose, factor }, probe.cost(&pose, f64::INFINITY))
    }

    /// Goes on by the matches alone, with hypotheses of theirs; returns what was known beside them. Optima that were met
    /// stay.
    pub(crate) fn without_priors(&mut self, minimal: Minimal) -> PosePriors {
        self.minimal = Some(minimal);
        std::mem::take(&mut self.priors)
    }

    /// The opposite: knows this from here on.
    pub(crate) fn with_priors(&mut self, known: PosePriors) {
        self.priors = known;
    }

    /// The correspondences it is about.
    pub(crate) fn matches(&self) -> &Matches<'a> {
        &self.matches
    }

    /// Whether the score is the likelihood.
    pub(crate) const fn is_likelihood(&self) -> bool {
        matches!(self.scale, Scale::Likelihood { .. })
    }

    /// Log likelihood ratio of each correspondence, `[N]`, at the noise that the inliers show.
    pub(crate) fn likelihoods(&self, polished: &Polished) -> Vec<f64> {
        match self.scale {
            Scale::Likelihood { .. } => self.kernel.likelihoods(&polished.pose, polished.noise),
            Scale::Msac { threshold } => {
                self.matches.log_likelihood_ratios(&polished.pose, threshold / MSAC_THRESHOLD_IN_NOISE)
            }
        }
    }

    /// Correspondences that agree with a pose: within the threshold, or likelier right than wrong.
    pub(crate) fn agreeing(&self, pose: &CameraFromWorld, likelihoods: &[f64]) -> Vec<usize> {
        match self.scale {
            Scale::Msac { .. } => self.within(pose, 1.0),
            Scale::Likelihood { .. } => (0..likelihoods.len()).filter(|&i| likelihoods[i] > 0.0).collect(),
        }
    }

    /// Under MSAC: correspondences within so many thresholds.
    fn within(&self, pose: &CameraFromWorld, factor: f64) -> Vec<usize> {
        let Scale::Msac { threshold } = self.scale else { return Vec::new() };
        let reach = threshold * factor;
        let near = |&i: &usize| self.matches.squared_error(i, pose).is_some_and(|e2| e2 < reach * reach);
        (0..self.matches.len()).filter(near).collect()
    }

    /// Refines at scales that shrink to the final one.
    pub(crate) fn descend(&self, pose: &CameraFromWorld) -> CameraFromWorld {
        let mut pose = *pose;
        for factor in LADDER {
            pose = match self.scale {
                Scale::Likelihood { noise } => {
                    let objective = |pose: &CameraFromWorld| {
                        self.with_prior_terms(pose, self.kernel.linearize_coarsely(pose, noise * factor))
                    };
                    descend(objective, &pose, LADDER_STEPS, COARSE_GAIN).pose
                }
                Scale::Msac { threshold } => {
                    let mut active = self.within(&pose, factor);
                    if active.len() < 6 {
                        continue;
                    }
                    let stride = active.len().div_ceil(DESCENT_LIMIT);
                    active = active.into_iter().step_by(stride).collect();
                    let loss = Loss::Truncated { threshold: threshold * factor };
                    refine(&self.matches, &active, loss, &pose, LADDER_STEPS).pose
                }
            };
        }
        pose
    }

    /// Final refinement and whether it was kept; under the likelihood at the noise that the inliers themselves show, if
    /// that is asked for.
    ///
    /// The guard: the refined pose must not be worse in the score it was refined for, over all correspondences. Without
    /// it a robust polish may slide into the collapse.
    pub(crate) fn polish(&self, start: &CameraFromWorld, estimate_noise: bool) -> Polished {
        self.polish_knowing(&self.priors, start, estimate_noise)
    }

    /// The same with this known beside the matches.
    fn polish_knowing(&self, known: &PosePriors, start: &CameraFromWorld, estimate_noise: bool) -> Polished {
        let with_prior_terms = |pose: &CameraFromWorld, mut system: System| {
            known.add_to(pose, &mut system);
            system
        };
        match self.scale {
            Scale::Msac { threshold } => {
                let active = self.within(start, 1.5);
                let pose =
                    refine(&self.matches, &active, Loss::Truncated { threshold }, start, FINAL_STEPS).pose;
                let kept = self.cost(&pose, f64::INFINITY) <= self.cost(start, f64::INFINITY);
                Polished { pose: if kept { pose } else { *start }, noise: threshold, kept }
            }
            Scale::Likelihood { noise: assumed } => {
                let (mut pose, mut noise) = (*start, assumed);
                for _ in 0..POLISH_ROUNDS {
                    let objective =
                        |pose: &CameraFromWorld| with_prior_terms(pose, self.kernel.linearize(pose, noise).0);
                    pose = descend(objective, &pose, ROUND_STEPS, 1e-7).pose;
                    if !estimate_noise {
                        break;
                    }
                    let shown = self.kernel.linearize(&pose, noise).1;
                    let next = shown.clamp(NOISE_RANGE[0] * assumed, NOISE_RANGE[1] * assumed);
                    let settled = (next / noise - 1.0).abs() < 0.02;
                    noise = next;
                    if settled {
                        break;
                    }
                }
                let active = self.possible(&pose, noise);
                let objective = |pose: &CameraFromWorld| {
                    with_prior_terms(
                        pose,
                        linearize(&self.matches, &active, Loss::Likelihood { noise }, pose),
                    )
                };
                pose = descend(objective, &pose, FINAL_STEPS, FINAL_GAIN).pose;
                let cost = |pose| self.kernel.cost_at(pose, noise) + known.loss(pose);
                let kept = cost(&pose) <= cost(start);
                Polished { pose: if kept { pose } else { *start }, noise, kept }
            }
        }
    }

    /// Correspondences that may be right at a pose.
    pub(crate) fn possible(&self, pose: &CameraFromWorld, noise: f64) -> Vec<usize> {
        let all = self.kernel.likelihoods(pose, noise);
        (0..all.len()).filter(|&i| all[i] > NEGLIGIBLE).collect()
    }

    /// The objective with what is known beside the matches.
    fn with_prior_terms(&self, pose: &CameraFromWorld, mut system: System) -> System {
        self.priors.add_to(pose, &mut system);
        system
    }

    /// What is known beside the matches.
    pub(crate) fn priors(&self) -> &PosePriors {
        &self.priors
    }

    /// Standard deviation of the agreeing residuals, pixels, and the covariance of the pose by the matches and what is
    /// known beside them.
    pub(crate) fn uncertainty(
        &self,
        known: &PosePriors,
        polished: &Polished,
        likelihoods: &[f64],
        inliers: &[usize],
        focal_sd: Option<f64>,
        free: Option<(Vector3<f64>, f64)>,
    ) -> (f64, Symmetric6) {
        let Polished { pose, noise, .. } = polished;
        match self.scale {
            Scale::Msac { .. } => {
                let system = linearize(&self.matches, inliers, Loss::Squared, pose);
                let freedom = (self.matches.residuals() * inliers.len()) as f64 - 6.0;
                let variance = 2.0 * system.loss / freedom.max(1.0);
                let information = if freedom > 0.0 { system.hessian / variance } else { Matrix6::zeros() };
                (variance.sqrt(), inverse_or_infinite(&information))
            }
            Scale::Likelihood { .. } => {
                let (mut sum, mut count) = (0.0, 0.0);
                for &i in inliers {
                    let right = 1.0 / (1.0 + (-likelihoods[i]).exp());
                    sum += right * self.matches.squared_error(i, pose).unwrap_or(0.0);
                    count += right * self.matches.residuals() as f64;
                }
                let shown = if count > 0.0 { (sum / count).sqrt() } else { *noise };
                let estimated = Estimated {
                    matches: &self.matches,
                    priors: known,
                    pose,
                    likelihoods,
                    noise: *noise,
                    focal_sd,
                    free,
                };
                (shown, estimated.covariance())
            }
        }
    }

    /// By how much the pose beats the best optimum that was met elsewhere; infinite when none was. The matches alone decide:
    /// what is known beside them may choose between two poses, and does not make the choice sure.
    pub(crate) fn margin(&self, polished: &Polished, covariance: &Symmetric6, estimate_noise: bool) -> f64 {
        let pose = &polished.pose;
        let own = self.cost(pose, f64::INFINITY) - self.priors.loss(pose);
        let nothing = PosePriors::default();
        let refined = |other: &CameraFromWorld| self.polish_knowing(&nothing, other, estimate_noise).pose;
        margin(&self.optima, pose, own, covariance, LEAST_MARGIN, refined)
    }
}

impl Estimator for Search<'_> {
    type Model = CameraFromWorld;

    fn is_stopped(&self) -> bool {
        self.stop.is_set()
    }

    fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<CameraFromWorld>) {
        if let Some(minimal) = &mut self.minimal {
            minimal.hypothesize(&self.matches, rng, models);
        }
    }

    fn cost(&self, model: &CameraFromWorld, best: f64) -> f64 {
        let known = self.priors.loss(model);
        self.kernel.cost(model, best - known) + known
    }

    fn hit_probability(&self, model: &CameraFromWorld) -> f64 {
        let likelihoods = match self.scale {
            Scale::Likelihood { noise } => self.kernel.likelihoods(model, noise),
            Scale::Msac { .. } => Vec::new(),
        };
        let agreeing = self.agreeing(model, &likelihoods);
        self.minimal.as_ref().map_or(0.0, |minimal| minimal.hit_probability(&self.matches, &agreeing))
    }

    fn optimize<R: Rng + ?Sized>(
        &mut self,
        model: &CameraFromWorld,
        cost: f64,
        rng: &mut R,
    ) -> (CameraFromWorld, f64) {
        let mut best = (*model, cost);
        let keep = |pose: CameraFromWorld, best: &mut (CameraFromWorld, f64)| {
            let cost = self.cost(&pose, best.1);
            if cost < best.1 {
                *best = (pose, cost);
            }
        };
        keep(self.descend(model), &mut best);
        if matches!(self.scale, Scale::Msac { .. }) {
            for _ in 0..SUBSETS {
                let inliers = self.within(&best.0, 1.0);
                if inliers.len() < 2 * SUBSET_SIZE {
                    break;
                }
                let subset: Vec<usize> =
                    (0..SUBSET_SIZE).map(|_| inliers[rng.random_range(0..inliers.len())]).collect();
                keep(refine(&self.matches, &subset, Loss::Squared, &best.0, 5).pose, &mut best);
            }
            keep(self.descend(&best.0), &mut best);
        }
        best.1 = self.cost_as_seen(&best.0, best.1);
        self.optima.push((best.0, best.1 - self.priors.loss(&best.0)));
        best
    }
}
