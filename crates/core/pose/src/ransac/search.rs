//! The estimator of a single image: one problem under one score, its hypotheses, local optimisation and final
//! refinement.
//!
//! Under the likelihood everything minimises one objective, `−Σ log(1 + exp llr)`: local optimisation at shrinking
//! scales, the final refinement at the scale that the inliers show. Under MSAC it is the truncated square.

use std::borrow::Cow;

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix6, Vector3};

use crate::ambiguity::margin;
use crate::confidence::MIN_MARGIN;
use crate::likelihood::{
    CovarianceInputs, Kernel, Loss, MIN_LOG_LIKELIHOOD_RATIO, Matches, PosePriors, PoseWithFocal, Scale,
    ScoreCells, Symmetric6, System, descend, inverse_or_infinite, linearize, refine,
};
use crate::ransac::Estimator;
use crate::ransac::Stop;
use crate::ransac::minimal::Minimal;

/// MSAC's threshold in multiples of the corresponding noise: the likelihood of its evidence uses this noise.
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

/// Allowed range of the noise in the final refinement, in multiples of the assumed one.
pub(crate) const NOISE_RANGE: [f64; 2] = [0.05, 1.5];

/// Steps of the last refinement, in double precision.
pub(crate) const FINAL_STEPS: usize = 25;

/// A step of the last refinement that gains less than this share ends it.
pub(crate) const FINAL_GAIN: f64 = 1e-9;

/// One problem under one score.
pub(crate) struct Search<'a> {
    matches: Cow<'a, Matches<'a>>,
    kernel: Kernel,
    scale: Scale,
    /// The sampler and solver of hypotheses; `None` after a pose was found.
    minimal: Option<Minimal>,
    /// The camera priors; empty under MSAC, the paper's recipe.
    priors: PosePriors,
    /// Optimised poses recorded during the search, with their costs by the matches alone.
    optima: Vec<(CameraFromWorld, f64)>,
    stop: Stop,
}

/// How the correspondences agree with a pose.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Agreement<'a> {
    /// Log likelihood ratio of each, `[N]`.
    pub(crate) likelihoods: &'a [f64],
    /// Those that agree.
    pub(crate) inliers: &'a [usize],
    /// [`Search::design_effect`], or 1 for errors as if they were independent.
    pub(crate) design_effect: f64,
}

/// A pose after the final refinement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polished {
    pub(crate) pose: CameraFromWorld,
    /// Scale of the likelihood's noise that the inliers show, pixels; under MSAC the threshold.
    pub(crate) noise: f64,
    /// Whether the refinement was accepted.
    pub(crate) accepted: bool,
}

impl<'a> Search<'a> {
    pub(crate) fn new(matches: &'a Matches<'a>, scale: Scale, minimal: Minimal, priors: PosePriors) -> Self {
        let kernel = Kernel::new(matches, scale);
        let (minimal, stop) = (Some(minimal), Stop::default());
        Self { matches: Cow::Borrowed(matches), kernel, scale, minimal, priors, optima: Vec::new(), stop }
    }

    /// This search with a stop flag.
    pub(crate) fn with_stop(mut self, stop: &Stop) -> Self {
        self.stop = stop.clone();
        self
    }

    /// The correspondences, ready to be scored.
    pub(crate) const fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// The cost of a pose that cannot see every correspondence; `cost` is the cost if it saw all.
    fn cost_as_seen(&self, pose: &CameraFromWorld, cost: f64) -> f64 {
        let Scale::Likelihood { noise } = self.scale else { return cost };
        let unseen = |(i, llr): (usize, f64)| {
            if llr > 0.0 { llr - (llr + self.matches.visibility(i, pose).ln()).max(0.0) } else { 0.0 }
        };
        cost + self.kernel.likelihoods(pose, noise).into_iter().enumerate().map(unseen).sum::<f64>()
    }

    /// Prepares for refinement after a pose was found, over the correspondences that the pose can see; sampling ends.
    pub(crate) fn fix_visible(&mut self, matches: Matches<'a>) {
        self.kernel = Kernel::new(&matches, self.scale);
        self.matches = Cow::Owned(matches);
        self.minimal = None;
    }

    /// The optimum near the pose with another focal length, and its cost.
    pub(crate) fn try_focal(
        &self,
        matches: Matches<'a>,
        pose: &CameraFromWorld,
        factor: f64,
    ) -> (PoseWithFocal, f64) {
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
        (PoseWithFocal { pose, factor }, probe.cost(&pose, f64::INFINITY))
    }

    /// Continues with the matches alone, with their own hypotheses; returns the removed priors. Recorded optima stay.
    pub(crate) fn without_priors(&mut self, minimal: Minimal) -> PosePriors {
        self.minimal = Some(minimal);
        std::mem::take(&mut self.priors)
    }

    /// The inverse: adds the priors.
    pub(crate) fn with_priors(&mut self, known: PosePriors) {
        self.priors = known;
    }

    /// The same for refinement with other priors.
    pub(crate) fn with_other_priors(&self, priors: PosePriors) -> Self {
        Search {
            matches: self.matches.clone(),
            kernel: self.kernel.clone(),
            minimal: None,
            priors,
            optima: self.optima.clone(),
            stop: self.stop.clone(),
            ..*self
        }
    }

    /// The correspondences of the search.
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

    /// Under MSAC: correspondences within a multiple of the threshold.
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

    /// Final refinement, and whether it was accepted; under the likelihood at the noise that the inliers show, if
    /// requested.
    ///
    /// The refined pose must not be worse in the score it was refined for, over all correspondences. Without this check
    /// a robust refinement may converge to the collapse.
    pub(crate) fn polish(&self, start: &CameraFromWorld, estimate_noise: bool) -> Polished {
        self.polish_with_priors(&self.priors, start, estimate_noise)
    }

    /// The same with the given priors.
    fn polish_with_priors(
        &self,
        known: &PosePriors,
        start: &CameraFromWorld,
        estimate_noise: bool,
    ) -> Polished {
        let with_prior_terms = |pose: &CameraFromWorld, mut system: System| {
            known.add_to(pose, &mut system);
            system
        };
        match self.scale {
            Scale::Msac { threshold } => {
                let active = self.within(start, 1.5);
                let pose =
                    refine(&self.matches, &active, Loss::Truncated { threshold }, start, FINAL_STEPS).pose;
                let accepted = self.cost(&pose, f64::INFINITY) <= self.cost(start, f64::INFINITY);
                Polished { pose: if accepted { pose } else { *start }, noise: threshold, accepted }
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
                let accepted = cost(&pose) <= cost(start);
                Polished { pose: if accepted { pose } else { *start }, noise, accepted }
            }
        }
    }

    /// Correspondences that may be right at a pose.
    pub(crate) fn possible(&self, pose: &CameraFromWorld, noise: f64) -> Vec<usize> {
        let all = self.kernel.likelihoods(pose, noise);
        (0..all.len()).filter(|&i| all[i] > MIN_LOG_LIKELIHOOD_RATIO).collect()
    }

    /// Adds the priors to the objective.
    fn with_prior_terms(&self, pose: &CameraFromWorld, mut system: System) -> System {
        self.priors.add_to(pose, &mut system);
        system
    }

    /// The camera priors.
    pub(crate) fn priors(&self) -> &PosePriors {
        &self.priors
    }

    /// Variance of errors that neighbouring matches share at a pose, in multiples of that of independent ones; 1 under
    /// MSAC.
    pub(crate) fn design_effect(&self, pose: &CameraFromWorld, likelihoods: &[f64], noise: f64) -> f64 {
        if !self.is_likelihood() {
            return 1.0;
        }
        let mut cells = ScoreCells::new(&self.matches.camera);
        for i in (0..likelihoods.len()).filter(|&i| likelihoods[i] > MIN_LOG_LIKELIHOOD_RATIO) {
            if let Some(residual) = self.matches.residual(i, pose, true) {
                let score = residual.score(&self.matches.likelihood_term(i, &residual, noise));
                cells.add(&residual.pixel, &score);
            }
        }
        cells.design_effect()
    }

    /// Standard deviation of the agreeing residuals, pixels, and the covariance of the pose from the matches and the
    /// given priors.
    pub(crate) fn uncertainty(
        &self,
        known: &PosePriors,
        polished: &Polished,
        agreement: &Agreement<'_>,
        focal_sd: Option<f64>,
        free: Option<(Vector3<f64>, f64)>,
    ) -> (f64, Symmetric6) {
        let Polished { pose, noise, .. } = polished;
        let Agreement { likelihoods, inliers, design_effect } = *agreement;
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
                let estimated = CovarianceInputs {
                    matches: &self.matches,
                    priors: known,
                    pose,
                    likelihoods,
                    noise: *noise,
                    focal_sd,
                    design_effect,
                    free,
                };
                (shown, estimated.covariance())
            }
        }
    }

    /// The margin of the pose over the best optimum at another pose; infinite when there is none. It uses the matches
    /// alone: priors may select one of two poses, but do not make the selection certain.
    pub(crate) fn margin(&self, polished: &Polished, covariance: &Symmetric6, estimate_noise: bool) -> f64 {
        let pose = &polished.pose;
        let own = self.cost(pose, f64::INFINITY) - self.priors.loss(pose);
        let nothing = PosePriors::default();
        let refined = |other: &CameraFromWorld| self.polish_with_priors(&nothing, other, estimate_noise).pose;
        margin(&self.optima, pose, own, covariance, MIN_MARGIN, refined)
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
