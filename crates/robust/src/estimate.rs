//! The pose of a query: one door for points, lines and anchored lines.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;

use crate::confidence::{Confidence, assess};
use crate::error::PoseError;
use crate::kernel::Scale;
use crate::matches::Matches;
use crate::minimal::Minimal;
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::problem::{Correspondences, PoseProblem};
use crate::ransac::{Budget, Estimator, lo_ransac};
use crate::search::Search;

/// Where the camera was, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseEstimate {
    /// The pose.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to.
    pub inlier_keypoints: usize,
    /// Minimal samples drawn.
    pub hypotheses: usize,
    /// What the search minimised, lower is better: the MSAC value in units of whole outliers (between 0 and `N`), or
    /// minus the log likelihood ratio against "all are outliers" (below 0).
    pub score: f64,
    /// Standard deviation that the inliers show, pixels: across the line, for points along each axis.
    pub noise_px: f64,
    /// Estimated focal length over the given one; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Covariance in the chart of [`CameraFromWorld::perturbed`] (radians, then map units): the variance of the
    /// inliers' residuals times the inverse of `JᵀJ`. Infinite on the diagonal when the inliers leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// Whether the final refinement was kept. It is dropped when it made the score worse.
    pub refined: bool,
}

impl PoseEstimate {
    /// Covariance of the camera centre in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.cam_from_world.center_covariance(&self.covariance)
    }
}

/// Estimates where the camera was.
///
/// LO-RANSAC with the solvers of the problem's kind, then a final refinement that is kept only when it does not make
/// the score worse. Equal problems, options and generator states give equal estimates.
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
    let mut search = search(&matches, problem, options);
    let budget = match options.fixed_hypotheses {
        Some(samples) => Budget::fixed(samples),
        None => Budget {
            min: options.min_hypotheses.min(options.max_hypotheses),
            max: options.max_hypotheses,
            confidence: options.confidence,
        },
    };
    let found = lo_ransac(&mut search, &budget, rng);
    conclude(search, &matches, found.model, found.samples, options)
}

/// Estimates where the camera was from a guess of it, such as the pose of the frame before.
///
/// The guess is optimised and refined on the same objective as [`estimate_pose`]'s hypotheses, over all
/// correspondences; nothing is sampled. From the true pose it gives the optimum that a search should find.
///
/// # Errors
/// As [`estimate_pose`]; the guess must agree with enough correspondences after refinement.
pub fn optimize_pose(
    problem: &PoseProblem,
    guess: &CameraFromWorld,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    if !guess.is_finite() {
        return Err(PoseError::NotFinite { what: "guess", index: 0 });
    }
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let search = search(&matches, problem, options);
    let descended = search.descend(guess);
    let start = if search.cost(&descended, f64::INFINITY) < search.cost(guess, f64::INFINITY) {
        descended
    } else {
        *guess
    };
    conclude(search, &matches, Some(start), 0, options)
}

fn search<'a>(matches: &'a Matches<'a>, problem: &PoseProblem, options: &PoseOptions) -> Search<'a> {
    let kind = options.score.unwrap_or_default();
    let scale = match kind {
        ScoreKind::Msac => {
            let lines = match matches.observations {
                Correspondences::Points { .. } => 1.0,
                Correspondences::Lines { .. } | Correspondences::Anchored { .. } => {
                    std::f64::consts::FRAC_1_SQRT_2
                }
            };
            Scale::Msac { threshold: options.max_error_px * lines }
        }
        ScoreKind::Likelihood => Scale::Likelihood { noise: options.noise_px },
    };
    let solver = options.anchored_solver.unwrap_or(AnchoredSolver::default_for(kind));
    let minimal = Minimal::new(matches, solver, problem.gravity.as_ref(), options.noise_px);
    Search::new(matches, scale, minimal)
}

/// Final refinement of the best pose, and what is said of it.
fn conclude(
    search: Search<'_>,
    matches: &Matches<'_>,
    best: Option<CameraFromWorld>,
    hypotheses: usize,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let no_consensus =
        |inliers| PoseError::NoConsensus { inliers, required: options.min_inliers, hypotheses };
    let Some(best) = best else { return Err(no_consensus(0)) };
    let matches = &matches.as_seen_from(&best);
    let search = search.settled(matches);
    let polished = search.polish(&best, options.estimate_noise);
    let likelihoods = search.likelihoods(&polished);
    let inliers = search.agreeing(&polished.pose, &likelihoods);
    let inlier_keypoints = matches.keypoints_among(inliers.iter().copied());
    if inlier_keypoints < options.min_inliers {
        return Err(no_consensus(inlier_keypoints));
    }
    let mut mask = vec![false; matches.len()];
    for &i in &inliers {
        mask[i] = true;
    }
    let (noise_px, covariance) = search.uncertainty(&polished, &likelihoods, &inliers);
    let margin = search.margin(&polished.pose, &covariance);
    Ok(PoseEstimate {
        cam_from_world: polished.pose,
        inlier_count: inliers.len(),
        inlier_keypoints,
        hypotheses,
        score: search.cost(&polished.pose, f64::INFINITY),
        noise_px,
        focal_scale: 1.0,
        covariance,
        confidence: assess(matches, &polished.pose, &inliers, &likelihoods, &covariance, margin),
        inliers: mask,
        refined: polished.kept,
    })
}
