//! The pose of a query: one door for points, lines and anchored lines.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;

use crate::beliefs::Beliefs;
use crate::confidence::{Confidence, Doubt, assess, free_direction};
use crate::covariance::free_along;
use crate::error::PoseError;
use crate::focal::{Verdict, ZoomObjective, Zoomed};
use crate::kernel::Scale;
use crate::matches::Matches;
use crate::minimal::Minimal;
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::problem::{Correspondences, FocalKnowledge, PoseProblem};
use crate::ransac::{Budget, Estimator, lo_ransac};
use crate::search::{Polished, Search};

/// Log evidence from which on a trusted pose is not asked whether another focal length would explain more.
const CLEAR: f64 = 150.0;

/// Focal lengths over a calibrated one that are tried from where the search ended: a wrong focal length may have led it to a
/// pose at which no small change of it helps.
const PROBES: [f64; 2] = [0.94, 1.06];

/// Log likelihood from which on a pose whose focal length is found fine is no false optimum of a wrong one: those had 350.
const PLENTY: f64 = 800.0;

/// Such jumps at most.
const MOST_JUMPS: usize = 4;

/// Log likelihood by which one of them must be better than what a small change must gain: it may have found another optimum.
const PROBE_HANDICAP: f64 = 2.5;

/// Rounds of estimating the focal length at the noise that the inliers show, and the noise again.
const FOCAL_ROUNDS: usize = 3;

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
    /// A direction along which nothing says where the camera is, a unit vector of the world frame: lines of one anchor say
    /// nothing along its ray. The position is then one of many, and the variance along it infinite.
    pub free_direction: Option<[f64; 3]>,
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
    let mut best = search_at(&matches, problem, options, 1.0, rng);
    // A calibrated focal length gives way to much more evidence only.
    let agreeing = best.as_ref().map_or(0, |estimate| estimate.inlier_count);
    let surplus = match problem.focal {
        FocalKnowledge::Calibrated => PROBE_HANDICAP + Verdict::least_gain(agreeing),
        FocalKnowledge::Exif | FocalKnowledge::Unknown => 0.0,
    };
    for &factor in other_focal_lengths(problem.focal, options.score.unwrap_or_default(), &best) {
        let other = search_at(&matches, problem, options, factor, rng);
        if worth(&other) > worth(&best) + surplus {
            best = other;
        }
        if is_clear(&best) {
            break;
        }
    }
    best
}

/// Searches with a focal length so many times as long as the given one.
fn search_at<R: Rng + ?Sized>(
    matches: &Matches<'_>,
    problem: &PoseProblem,
    options: &PoseOptions,
    factor: f64,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    let zoomed = matches.with_focal(factor);
    let mut search = search(&zoomed, problem, options);
    let budget = match options.fixed_hypotheses {
        Some(samples) => Budget::fixed(samples),
        None => Budget {
            min: options.min_hypotheses.min(options.max_hypotheses),
            max: options.max_hypotheses,
            confidence: options.confidence,
        },
    };
    let found = lo_ransac(&mut search, &budget, rng);
    let start = found.model.map(|pose| Zoomed { pose, factor });
    conclude(search, matches, start, found.samples, problem.focal, options).map_err(|error| {
        if has_one_side(problem) { PoseError::OneSided { lines: matches.len() } } else { error }
    })
}

/// Whether all lines run through one anchor.
fn has_one_side(problem: &PoseProblem) -> bool {
    match &problem.observations {
        Correspondences::Anchored { lines, .. } => lines.iter().all(|(anchor, _)| *anchor == lines[0].0),
        Correspondences::Points { .. } | Correspondences::Lines { .. } => false,
    }
}

/// Other focal lengths to search with, over the given one, when that leaves a doubt or does not show much evidence: all that a phone's guess may be wrong
/// by when it is a guess, and for a measured one only when something was found that the focal length may have spoilt.
fn other_focal_lengths(
    focal: FocalKnowledge,
    score: ScoreKind,
    found: &Result<PoseEstimate, PoseError>,
) -> &'static [f64] {
    if score == ScoreKind::Msac || is_clear(found) {
        return &[];
    }
    match focal {
        FocalKnowledge::Calibrated if worth(found) < 0.0 => &[],
        FocalKnowledge::Calibrated | FocalKnowledge::Exif => &[0.87, 1.15, 0.75, 1.33],
        FocalKnowledge::Unknown => &[0.8, 1.25, 0.65, 1.55],
    }
}

fn is_clear(found: &Result<PoseEstimate, PoseError>) -> bool {
    // A suspicious focal length was looked at already.
    let other = |doubt: &Doubt| !matches!(doubt, Doubt::FocalLength { .. });
    found
        .as_ref()
        .is_ok_and(|e| e.confidence.log_evidence > CLEAR && !e.confidence.doubts().iter().any(other))
}

/// Log evidence, least when nothing was found.
fn worth(found: &Result<PoseEstimate, PoseError>) -> f64 {
    found.as_ref().map_or(f64::NEG_INFINITY, |estimate| estimate.confidence.log_evidence)
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
    let start = Some(Zoomed { pose: start, factor: 1.0 });
    conclude(search, &matches, start, 0, problem.focal, options)
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
    let beliefs = match kind {
        ScoreKind::Msac => Beliefs::default(),
        ScoreKind::Likelihood => Beliefs::of(problem),
    };
    Search::new(matches, scale, minimal, beliefs)
}

/// Final refinement of the best pose, and what is said of it.
///
/// `matches` are those of the focal length as given; the start names the one that it was found with.
fn conclude<'a>(
    search: Search<'a>,
    matches: &Matches<'a>,
    start: Option<Zoomed>,
    hypotheses: usize,
    focal: FocalKnowledge,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let no_consensus =
        |inliers| PoseError::NoConsensus { inliers, required: options.min_inliers, hypotheses };
    let Some(mut at) = start else { return Err(no_consensus(0)) };
    let seen = matches.as_seen_from(&at.pose);
    let mut search = search.settled(seen.with_focal(at.factor));
    let mut polished = search.polish(&at.pose, options.estimate_noise);
    let zoom = |search: &Search<'_>, polished: &Polished| ZoomObjective {
        matches: &seen,
        beliefs: search.beliefs().clone(),
        active: search.possible(&polished.pose, polished.noise),
        noise: polished.noise,
        sd: focal.sd(),
    };
    // Another focal length that explains more, and how much more.
    let jump = |search: &Search<'a>, polished: &Polished, at: &Zoomed| {
        let own = search.cost(&polished.pose, f64::INFINITY);
        PROBES
            .iter()
            .map(|step| step * at.factor)
            .map(|factor| search.probe(seen.with_focal(factor), &polished.pose, factor))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(zoomed, cost)| (zoomed, own - cost - PROBE_HANDICAP))
    };
    let mut verdict = match focal {
        FocalKnowledge::Exif | FocalKnowledge::Unknown => Verdict::Wrong,
        FocalKnowledge::Calibrated if at.factor != 1.0 => Verdict::Wrong,
        FocalKnowledge::Calibrated => zoom(&search, &polished).verdict(&polished.pose),
    };
    if search.is_likelihood() {
        for _ in 0..MOST_JUMPS {
            if verdict == Verdict::Wrong {
                for _ in 0..FOCAL_ROUNDS {
                    at = zoom(&search, &polished).refine(&Zoomed { pose: polished.pose, factor: at.factor });
                    search = search.settled(seen.with_focal(at.factor));
                    polished = search.polish(&at.pose, options.estimate_noise);
                }
            }
            let plenty = search.cost(&polished.pose, f64::INFINITY) < -PLENTY;
            if verdict == Verdict::Fine && plenty {
                break;
            }
            let Some((zoomed, gain)) = jump(&search, &polished, &at) else { break };
            // A focal length that is open goes where the likelihood is; a calibrated one must be contradicted.
            let agreeing = match verdict {
                Verdict::Wrong => 0,
                Verdict::Fine | Verdict::Suspicious(_) => {
                    search.agreeing(&polished.pose, &search.likelihoods(&polished)).len()
                }
            };
            match Verdict::of(gain, zoomed.factor, agreeing) {
                Verdict::Wrong => {
                    (at, verdict) = (zoomed, Verdict::Wrong);
                    search = search.settled(seen.with_focal(at.factor));
                    polished = search.polish(&at.pose, options.estimate_noise);
                }
                Verdict::Suspicious(factor) => {
                    if verdict == Verdict::Fine {
                        verdict = Verdict::Suspicious(factor);
                    }
                    break;
                }
                Verdict::Fine => break,
            }
        }
    }
    let is_open = verdict == Verdict::Wrong;
    let focal_sd = (is_open && search.is_likelihood()).then(|| focal.sd());
    let matches = search.matches();
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
    let (noise_px, mut covariance) = search.uncertainty(&polished, &likelihoods, &inliers, focal_sd, None);
    let free = free_direction(matches, &polished.pose, &inliers, &likelihoods, &covariance);
    if free.is_some() {
        covariance = search.uncertainty(&polished, &likelihoods, &inliers, focal_sd, free).1;
    }
    let margin = search.margin(&polished.pose, &covariance);
    let known = search.beliefs().loss(&polished.pose);
    let mut confidence = assess(matches, &polished.pose, &inliers, &likelihoods, &covariance, margin);
    confidence.log_evidence -= known;
    if let Verdict::Suspicious(factor) = verdict
        && search.is_likelihood()
    {
        confidence.other_focal = Some(factor);
    }
    if let Some((direction, _)) = free {
        covariance = free_along(&covariance, &direction);
        confidence = confidence.held_only_across();
    }
    Ok(PoseEstimate {
        cam_from_world: polished.pose,
        inlier_count: inliers.len(),
        inlier_keypoints,
        hypotheses,
        score: search.cost(&polished.pose, f64::INFINITY),
        noise_px,
        focal_scale: at.factor,
        covariance,
        confidence,
        free_direction: free.map(|(d, _)| (polished.pose.rotation().inverse() * d).into()),
        inliers: mask,
        refined: polished.kept,
    })
}
