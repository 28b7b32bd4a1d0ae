//! The pose of a query: one door for points, lines and anchored lines.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;

use crate::confidence::assess;
use crate::error::PoseError;
use crate::kernel::{Kernel, Scale};
use crate::matches::{Kind, Matches};
use crate::minimal::Minimal;
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::problem::{PoseEstimate, PoseProblem};
use crate::ransac::{Budget, Estimator, lo_ransac};
use crate::refine::{Loss, covariance, refine, shown_noise};

/// Shrinking scales of local optimisation, in multiples of the final one.
const LADDER: [f64; 3] = [4.0, 2.0, 1.0];

/// Steps at each scale.
const LADDER_STEPS: usize = 4;

/// More correspondences than this are thinned out evenly in local optimisation; the final refinement takes all.
const DESCENT_LIMIT: usize = 800;

/// Subsets of the inliers tried in local optimisation, and their size.
const SUBSETS: usize = 8;
const SUBSET_SIZE: usize = 14;

/// Rounds of final refinement and noise estimation.
const POLISH_ROUNDS: usize = 6;

/// Smallest noise the final refinement believes in, as a share of the assumed one.
const LEAST_NOISE: f64 = 0.2;

/// Steps of the final refinement.
const FINAL_STEPS: usize = 25;

/// Estimates where the camera was.
///
/// LO-RANSAC with `p3p` for points and `p6lp` for lines, then a final refinement that is kept only when it does not
/// make the score worse. Equal problems, options and generator states give equal estimates.
///
/// # Errors
/// [`PoseError`]: input that is inconsistent or not finite, too few correspondences, all lines of one anchor, or no
/// pose with enough inliers.
pub fn estimate_pose<R: Rng + ?Sized>(
    problem: &PoseProblem,
    options: &PoseOptions,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let anchored = matches!(matches.kind, Kind::Anchored(_));
    let kind = options.score.unwrap_or(ScoreKind::default_for(anchored));
    let scale = match kind {
        ScoreKind::Msac => {
            let lines = if matches.kind == Kind::Points { 1.0 } else { std::f64::consts::FRAC_1_SQRT_2 };
            Scale::Msac { threshold: options.max_error_px * lines }
        }
        ScoreKind::Likelihood => Scale::Likelihood { noise: options.noise_px },
    };
    let kernel = Kernel::new(&matches, scale);
    let solver = options.anchored_solver.unwrap_or(AnchoredSolver::default_for(kind));
    let minimal = Minimal::new(&matches, solver, options.noise_px);
    let mut search = Search { matches: &matches, kernel, scale, minimal };

    let budget = match options.fixed_hypotheses {
        Some(samples) => Budget::fixed(samples),
        None => Budget {
            min: options.min_hypotheses.min(options.max_hypotheses),
            max: options.max_hypotheses,
            confidence: options.confidence,
        },
    };
    let found = lo_ransac(&mut search, &budget, rng);
    let no_consensus = |inliers| PoseError::NoConsensus {
        inliers,
        required: options.min_inliers,
        hypotheses: found.samples,
    };
    let Some(best) = found.model else { return Err(no_consensus(0)) };

    let (pose, refined) = search.polish(&best);
    let score = search.kernel.cost(&pose, f64::INFINITY);

    let inliers = search.inliers(&pose);
    if inliers.len() < options.min_inliers {
        return Err(no_consensus(inliers.len()));
    }
    let mut mask = vec![false; matches.len()];
    for &i in &inliers {
        mask[i] = true;
    }
    let covariance = covariance(&matches, &inliers, &pose);
    let noise_px = shown_noise(&matches, &inliers, options.noise_px, &pose);
    Ok(PoseEstimate {
        cam_from_world: pose,
        inliers: mask,
        inlier_count: inliers.len(),
        hypotheses: found.samples,
        score,
        noise_px,
        covariance,
        confidence: assess(&matches, &pose, &inliers, noise_px, &covariance, f64::INFINITY),
        refined,
    })
}

/// What the loop searches with.
struct Search<'a> {
    matches: &'a Matches,
    kernel: Kernel,
    scale: Scale,
    minimal: Minimal,
}

impl Search<'_> {
    /// Correspondences that agree with a pose.
    fn inliers(&self, pose: &CameraFromWorld) -> Vec<usize> {
        self.within(pose, 1.0, 0.0)
    }

    /// Correspondences that agree at a scale this many times the final one, or nearly (`slack` in log likelihood).
    fn within(&self, pose: &CameraFromWorld, factor: f64, slack: f64) -> Vec<usize> {
        let agrees = |i: usize| match self.scale {
            Scale::Msac { threshold } => {
                let reach = threshold * factor;
                self.matches.squared_error(i, pose).is_some_and(|e2| e2 < reach * reach)
            }
            Scale::Likelihood { noise } => {
                self.matches.log_likelihood_ratio(i, pose, noise * factor).is_some_and(|llr| llr > -slack)
            }
        };
        (0..self.matches.len()).filter(|&i| agrees(i)).collect()
    }

    /// Refines with thresholds that shrink to the final one.
    fn descend(&self, pose: &CameraFromWorld) -> CameraFromWorld {
        let mut pose = *pose;
        for factor in LADDER {
            let mut active = self.within(&pose, factor, 4.0);
            if active.len() < 6 {
                continue;
            }
            if active.len() > DESCENT_LIMIT {
                let stride = active.len().div_ceil(DESCENT_LIMIT);
                active = active.into_iter().step_by(stride).collect();
            }
            pose = refine(self.matches, &active, loss(self.scale, factor), &pose, LADDER_STEPS).pose;
        }
        pose
    }

    /// Final refinement and whether it was kept; under the likelihood with the noise that the inliers themselves show.
    ///
    /// The guard: the refined pose must not be worse in the score it was refined for, over all correspondences. Without
    /// it a robust polish may slide into the collapse.
    fn polish(&self, start: &CameraFromWorld) -> (CameraFromWorld, bool) {
        let mut pose = *start;
        let mut scale = self.scale;
        for _ in 0..POLISH_ROUNDS {
            let active = self.within(&pose, 1.5, 6.0);
            pose = refine(self.matches, &active, loss(scale, 1.0), &pose, FINAL_STEPS).pose;
            let (Scale::Likelihood { noise: assumed }, Scale::Likelihood { noise: now }) =
                (self.scale, scale)
            else {
                break;
            };
            let shown = shown_noise(self.matches, &active, now, &pose).clamp(LEAST_NOISE * assumed, assumed);
            if (shown / now - 1.0).abs() < 0.02 {
                break;
            }
            scale = Scale::Likelihood { noise: shown };
        }
        let kernel = Kernel::new(self.matches, scale);
        let kept = kernel.cost(&pose, f64::INFINITY) <= kernel.cost(start, f64::INFINITY);
        if kept { (pose, true) } else { (*start, false) }
    }
}

fn loss(scale: Scale, factor: f64) -> Loss {
    match scale {
        Scale::Msac { threshold } => Loss::Truncated { threshold: threshold * factor },
        Scale::Likelihood { noise } => Loss::Likelihood { noise: noise * factor },
    }
}

impl Estimator for Search<'_> {
    type Model = CameraFromWorld;

    fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<CameraFromWorld>) {
        self.minimal.hypothesize(self.matches, rng, models);
    }

    fn cost(&self, model: &CameraFromWorld, best: f64) -> f64 {
        self.kernel.cost(model, best)
    }

    fn hit_probability(&self, model: &CameraFromWorld) -> f64 {
        self.minimal.hit_probability(self.matches, &self.inliers(model))
    }

    fn optimize<R: Rng + ?Sized>(
        &mut self,
        model: &CameraFromWorld,
        cost: f64,
        rng: &mut R,
    ) -> Option<(CameraFromWorld, f64)> {
        let mut best = (*model, cost);
        let keep = |pose: CameraFromWorld, best: &mut (CameraFromWorld, f64)| {
            let cost = self.kernel.cost(&pose, best.1);
            let better = cost < best.1;
            if better {
                *best = (pose, cost);
            }
            better
        };
        keep(self.descend(model), &mut best);
        for _ in 0..SUBSETS {
            let inliers = self.inliers(&best.0);
            if inliers.len() < 2 * SUBSET_SIZE {
                break;
            }
            let subset: Vec<usize> =
                (0..SUBSET_SIZE).map(|_| inliers[rng.random_range(0..inliers.len())]).collect();
            let fitted = refine(self.matches, &subset, Loss::Squared, &best.0, 5).pose;
            keep(fitted, &mut best);
        }
        keep(self.descend(&best.0), &mut best);
        (best.1 < cost).then_some(best)
    }
}
