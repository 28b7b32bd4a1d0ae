//! The paper's recipe for one image: LO-RANSAC under MSAC, the truncated square of the pixel distance.
//!
//! It is kept to reproduce the paper's tables. The camera is taken as given, priors are ignored, and the covariance is the
//! residuals' variance times `(JᵀJ)⁻¹`.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;

use crate::confidence::ambiguity::margin;
use crate::confidence::{MIN_MARGIN, assess, free_direction};
use crate::error::PoseError;
use crate::estimate::pose_estimate::PoseEstimate;
use crate::likelihood::{
    Correspondences, Kernel, Loss, Matches, PoseProblem, Scale, free_along, inverse_or_infinite, linearize,
    refine,
};
use crate::options::PoseOptions;
use crate::ransac::minimal::Minimal;
use crate::ransac::{Estimator, Stop, lo_ransac};
use crate::rig::{FINAL_STEPS, LADDER, LADDER_STEPS};

/// The threshold in multiples of the corresponding noise: the likelihood of its evidence uses this noise.
const THRESHOLD_IN_NOISE: f64 = 2.5;

/// More correspondences than this are thinned out evenly in local optimisation.
const DESCENT_LIMIT: usize = 800;

/// Subsets of the inliers tried in local optimisation, and their size.
const SUBSETS: usize = 8;
const SUBSET_SIZE: usize = 14;

struct Search<'a> {
    matches: &'a Matches<'a>,
    kernel: Kernel,
    /// Pixels.
    threshold: f64,
    minimal: Minimal,
    /// Optimised poses, with their costs.
    optima: Vec<(CameraFromWorld, f64)>,
    stop: Stop,
}

/// [`crate::estimate_pose`] for a checked problem.
pub(crate) fn estimate<R: Rng + ?Sized>(
    problem: &PoseProblem,
    options: &PoseOptions,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let mut search = Search::new(&matches, problem, options);
    let found = lo_ransac(&mut search, &options.budget(1), rng);
    if options.stop.is_set() {
        return Err(PoseError::Stopped);
    }
    search.conclude(found.model, found.samples, options).map_err(|error| {
        if has_one_side(problem) { PoseError::OneSided { lines: matches.len() } } else { error }
    })
}

/// [`crate::optimize_pose`] for a checked problem.
pub(crate) fn optimize(
    problem: &PoseProblem,
    initial: &CameraFromWorld,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let search = Search::new(&matches, problem, options);
    let descended = search.descend(initial);
    let cost = |pose| search.cost(pose, f64::INFINITY);
    let start = if cost(&descended) < cost(initial) { descended } else { *initial };
    search.conclude(Some(start), 0, options)
}

impl<'a> Search<'a> {
    fn new(matches: &'a Matches<'a>, problem: &PoseProblem, options: &PoseOptions) -> Self {
        let of_kind = match matches.observations {
            Correspondences::Points { .. } => 1.0,
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => {
                std::f64::consts::FRAC_1_SQRT_2
            }
        };
        let threshold = options.max_error_px * of_kind;
        Self {
            matches,
            kernel: Kernel::new(matches, Scale::Msac { threshold }),
            threshold,
            minimal: Minimal::new(matches, options.solver(), problem.gravity.as_ref(), options.noise_px),
            optima: Vec::new(),
            stop: options.stop.clone(),
        }
    }

    /// Correspondences within a multiple of the threshold.
    fn within(&self, pose: &CameraFromWorld, factor: f64) -> Vec<usize> {
        let limit = (self.threshold * factor).powi(2);
        let is_near = |&i: &usize| self.matches.squared_error(i, pose).is_some_and(|e2| e2 < limit);
        (0..self.matches.len()).filter(is_near).collect()
    }

    /// Refines at thresholds that shrink to the final one.
    fn descend(&self, pose: &CameraFromWorld) -> CameraFromWorld {
        let mut pose = *pose;
        for factor in LADDER {
            let mut active = self.within(&pose, factor);
            if active.len() >= 6 {
                let stride = active.len().div_ceil(DESCENT_LIMIT);
                active = active.into_iter().step_by(stride).collect();
                let loss = Loss::Truncated { threshold: self.threshold * factor };
                pose = refine(self.matches, &active, loss, &pose, LADDER_STEPS).pose;
            }
        }
        pose
    }

    /// The final refinement, accepted only when it does not make the score worse: a robust refinement may converge to
    /// the collapse of the scene into an anchor.
    fn polish(&self, start: &CameraFromWorld) -> (CameraFromWorld, bool) {
        let loss = Loss::Truncated { threshold: self.threshold };
        let refined = refine(self.matches, &self.within(start, 1.5), loss, start, FINAL_STEPS).pose;
        let accepted = self.cost(&refined, f64::INFINITY) <= self.cost(start, f64::INFINITY);
        (if accepted { refined } else { *start }, accepted)
    }

    fn conclude(
        &self,
        start: Option<CameraFromWorld>,
        hypotheses: usize,
        options: &PoseOptions,
    ) -> Result<PoseEstimate, PoseError> {
        let no_consensus =
            |inliers| PoseError::NoConsensus { inliers, required: options.min_inliers, hypotheses };
        let (pose, refined) = self.polish(&start.ok_or(no_consensus(0))?);
        let matches = self.matches;
        let chosen = self.within(&pose, 1.0);
        let inlier_keypoints = matches.keypoints_among(chosen.iter().copied());
        if inlier_keypoints < options.min_inliers {
            return Err(no_consensus(inlier_keypoints));
        }
        let system = linearize(matches, &chosen, Loss::Squared, &pose);
        let freedom = (matches.residuals() * chosen.len()) as f64 - 6.0;
        let variance = 2.0 * system.loss / freedom.max(1.0);
        let information = system.hessian * if freedom > 0.0 { variance.recip() } else { 0.0 };
        let mut covariance = inverse_or_infinite(&information);
        let likelihoods = matches.log_likelihood_ratios(&pose, self.threshold / THRESHOLD_IN_NOISE);
        let score = self.cost(&pose, f64::INFINITY);
        let refined_other = |other: &CameraFromWorld| self.polish(other).0;
        let margin = margin(&self.optima, &pose, score, &covariance, MIN_MARGIN, refined_other);
        let free = free_direction(matches, &pose, &chosen, &likelihoods, &covariance);
        let mut confidence = assess(matches, &pose, &chosen, &likelihoods, &covariance, margin);
        if let Some((direction, _)) = &free {
            covariance = free_along(&covariance, direction);
            confidence = confidence.with_free_direction();
        }
        let mut inliers = vec![false; matches.len()];
        for &i in &chosen {
            inliers[i] = true;
        }
        Ok(PoseEstimate {
            cam_from_world: pose,
            inliers,
            inlier_count: chosen.len(),
            inlier_keypoints,
            hypotheses,
            score,
            noise_px: variance.sqrt(),
            free_direction: free.map(|(d, _)| (pose.rotation().inverse() * d).into()),
            covariance,
            covariance_by_matches: covariance,
            confidence,
            refined,
            focal_scale: 1.0,
            principal_shift_px: [0.0; 2],
            camera_covariance: [[0.0; 6]; 6],
            camera_evidence: None,
            gravity_test: None,
            rival: None,
        })
    }
}

impl Estimator for Search<'_> {
    type Model = CameraFromWorld;

    fn is_stopped(&self) -> bool {
        self.stop.is_set()
    }

    fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<CameraFromWorld>) {
        self.minimal.hypothesize(self.matches, rng, models);
    }

    fn cost(&self, model: &CameraFromWorld, best: f64) -> f64 {
        self.kernel.cost(model, best)
    }

    fn hit_probability(&self, model: &CameraFromWorld) -> f64 {
        self.minimal.hit_probability(self.matches, &self.within(model, 1.0))
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
        for _ in 0..SUBSETS {
            let inliers = self.within(&best.0, 1.0);
            if inliers.len() < 2 * SUBSET_SIZE {
                break;
            }
            let subset: Vec<usize> =
                (0..SUBSET_SIZE).map(|_| inliers[rng.random_range(0..inliers.len())]).collect();
            keep(refine(self.matches, &subset, Loss::Squared, &best.0, 5).pose, &mut best);
        }
        keep(self.descend(&best.0), &mut best);
        self.optima.push(best);
        best
    }
}

/// Whether all lines belong to one anchor.
pub(crate) fn has_one_side(problem: &PoseProblem) -> bool {
    match &problem.observations {
        Correspondences::Anchored { lines, .. } => lines.iter().all(|(anchor, _)| *anchor == lines[0].0),
        Correspondences::Points { .. } | Correspondences::Lines { .. } => false,
    }
}
