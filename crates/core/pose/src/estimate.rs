//! The pose of a query: one entry point for points, lines and anchored lines.

use rand::Rng;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::deviations::position_sd;

use crate::camera_refinement::{CameraRefinement, CameraTest};
use crate::confidence::{assess, free_direction};
use crate::copies::WithoutCopies;
use crate::error::PoseError;
use crate::focal_search::{BestCost, FocalRefinement, ImageEstimate, over_focal_lengths};
use crate::likelihood::{
    CameraEvidence, Correspondences, FocalPrior, FocalVerdict, GravityTest, Matches, PosePriors, PoseProblem,
    PoseWithFocal, Scale, Symmetric6, free_along, sum, with_shift,
};
use crate::options::{AnchoredSolver, PoseOptions, ScoreKind};
use crate::pose_estimate::PoseEstimate;
use crate::ransac::minimal::Minimal;
use crate::ransac::search::{Agreement, Search};
use crate::ransac::{Budget, Estimator, lo_ransac};
use crate::rival::find_rival;

/// Estimates the pose of a camera.
///
/// LO-RANSAC with the solvers of the problem's kind, then a final refinement, which is accepted only when it does not
/// make the score worse. Equal problems, options and generator states give equal estimates.
///
/// Equal correspondences count as one, and of many for one map point, or on one spot of the image and the map, only the
/// four most probable count (not under [`ScoreKind::Msac`]): they have one cause. Equal ones have equal flags in
/// [`PoseEstimate::inliers`]; those that do not count are not inliers.
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
    if options.score.unwrap_or_default() == ScoreKind::Msac {
        let matches = Matches::new(problem, options.expected_inlier_ratio);
        return search_at(&matches, problem, options, 1.0, &mut BestCost::default(), rng);
    }
    without_copies(problem, |problem| estimate_checked(problem, options, rng))
}

/// Runs an estimation on the problem without copies.
fn without_copies(
    problem: &PoseProblem,
    estimate: impl FnOnce(&PoseProblem) -> Result<PoseEstimate, PoseError>,
) -> Result<PoseEstimate, PoseError> {
    let Some(without) = WithoutCopies::of(problem) else { return estimate(problem) };
    without.problem.check()?;
    let mut estimate = estimate(&without.problem)?;
    estimate.inliers = without.expand(&estimate.inliers);
    estimate.inlier_count = estimate.inliers.iter().filter(|is_inlier| **is_inlier).count();
    Ok(estimate)
}

/// [`estimate_pose`] under the likelihood, for a checked problem without copies.
fn estimate_checked<R: Rng + ?Sized>(
    problem: &PoseProblem,
    options: &PoseOptions,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let mut cost = BestCost::default();
    let best = over_focal_lengths(problem.focal, options, |factor, options| {
        let observations = &problem.observations;
        search_at(&matches, problem, options, factor, &mut cost, rng)
            .map(|estimate| ImageEstimate { estimate, observations })
    });
    // The optimum lies between two tried focal lengths: the best of them may not be the best of all.
    if options.stop.is_set() {
        return Err(PoseError::Stopped);
    }
    let mut best = best?.estimate;
    if options.fixed_hypotheses.is_none() {
        best.rival = find_rival(&matches, problem, &best, options, rng);
        best.confidence.rival_log_evidence = best.rival.map(|rival| rival.log_evidence);
    }
    Ok(best)
}

/// Searches with the given focal length multiplied by a factor; refines the result unless another focal length led to a
/// much better one.
fn search_at<R: Rng + ?Sized>(
    matches: &Matches<'_>,
    problem: &PoseProblem,
    options: &PoseOptions,
    factor: f64,
    best_cost: &mut BestCost,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    if options.stop.is_set() {
        return Err(PoseError::Stopped);
    }
    let zoomed = matches.with_focal(factor);
    let mut search = search(&zoomed, problem, options);
    // The search uses the camera priors, and is then repeated without them: a wrong prior would hide the pose, or other
    // poses that the matches explain as well.
    let budget = match options.fixed_hypotheses {
        Some(samples) if !search.priors().is_empty() => Budget::fixed(samples.div_ceil(2)),
        _ => options.budget(1),
    };
    let mut found = lo_ransac(&mut search, &budget, rng);
    if !search.priors().is_empty() {
        let without = Minimal::new(&zoomed, solver(options), None, options.noise_px);
        let known = search.without_priors(without);
        let alone = lo_ransac(&mut search, &budget, rng);
        let cost = alone.model.as_ref().map_or(f64::INFINITY, |pose| alone.cost + known.loss(pose));
        if cost < found.cost {
            (found.model, found.cost) = (alone.model, cost);
        }
        found.samples += alone.samples;
        search.with_priors(known);
    }
    if options.stop.is_set() {
        return Err(PoseError::Stopped);
    }
    if found.model.is_some() && !best_cost.is_near(found.cost) {
        let (required, hypotheses) = (options.min_inliers, found.samples);
        return Err(PoseError::NoConsensus { inliers: 0, required, hypotheses });
    }
    let start = found.model.map(|pose| PoseWithFocal { pose, factor });
    conclude(search, matches, start, found.samples, problem, options).map_err(|error| {
        if has_one_side(problem) { PoseError::OneSided { lines: matches.len() } } else { error }
    })
}

/// Whether all lines belong to one anchor.
fn has_one_side(problem: &PoseProblem) -> bool {
    match &problem.observations {
        Correspondences::Anchored { lines, .. } => lines.iter().all(|(anchor, _)| *anchor == lines[0].0),
        Correspondences::Points { .. } | Correspondences::Lines { .. } => false,
    }
}

/// Estimates the pose of a camera from an initial pose, such as the pose of the previous frame.
///
/// The initial pose is optimised and refined with the objective of [`estimate_pose`], over all correspondences, without
/// sampling. From the true pose it gives the optimum that a search should find.
///
/// # Errors
/// As [`estimate_pose`]; the refined pose must agree with enough correspondences.
pub fn optimize_pose(
    problem: &PoseProblem,
    initial: &CameraFromWorld,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    if !initial.is_finite() {
        return Err(PoseError::NotFinite { what: "initial pose", index: 0 });
    }
    if options.score.unwrap_or_default() == ScoreKind::Msac {
        return optimize_checked(problem, initial, options);
    }
    without_copies(problem, |problem| optimize_checked(problem, initial, options))
}

/// [`optimize_pose`] for a checked problem.
fn optimize_checked(
    problem: &PoseProblem,
    initial: &CameraFromWorld,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let matches = Matches::new(problem, options.expected_inlier_ratio);
    let search = search(&matches, problem, options);
    let descended = search.descend(initial);
    let start = if search.cost(&descended, f64::INFINITY) < search.cost(initial, f64::INFINITY) {
        descended
    } else {
        *initial
    };
    let start = Some(PoseWithFocal { pose: start, factor: 1.0 });
    conclude(search, &matches, start, 0, problem, options)
}

/// The solver for hypotheses from anchored lines.
fn solver(options: &PoseOptions) -> AnchoredSolver {
    options.anchored_solver.unwrap_or(AnchoredSolver::default_for(options.score.unwrap_or_default()))
}

pub(crate) fn search<'a>(
    matches: &'a Matches<'a>,
    problem: &PoseProblem,
    options: &PoseOptions,
) -> Search<'a> {
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
    let minimal = Minimal::new(matches, solver(options), problem.gravity.as_ref(), options.noise_px);
    let priors = match kind {
        ScoreKind::Msac => PosePriors::default(),
        ScoreKind::Likelihood => PosePriors::of(problem),
    };
    Search::new(matches, scale, minimal, priors).with_stop(&options.stop)
}

/// Final refinement of the best pose, and its confidence. A gravity direction that the matches contradict has no
/// influence on the pose.
///
/// `matches` have the given focal length; `start` contains the focal length of the search.
pub(crate) fn conclude<'a>(
    search: Search<'a>,
    matches: &Matches<'a>,
    start: Option<PoseWithFocal>,
    hypotheses: usize,
    problem: &PoseProblem,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let known = search.priors();
    let without = known.has_gravity().then(|| search.with_other_priors(known.without_gravity()));
    let estimate = conclude_with_priors(search, matches, start, hypotheses, problem, options)?;
    match without {
        Some(without) if !estimate.confidence.gravity.is_some_and(|gravity| gravity.is_close()) => {
            conclude_with_priors(without, matches, start, hypotheses, problem, options)
        }
        _ => Ok(estimate),
    }
}

/// [`conclude`] with the priors of the search.
fn conclude_with_priors<'a>(
    search: Search<'a>,
    matches: &Matches<'a>,
    start: Option<PoseWithFocal>,
    hypotheses: usize,
    problem: &PoseProblem,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    let focal = problem.focal;
    let no_consensus =
        |inliers| PoseError::NoConsensus { inliers, required: options.min_inliers, hypotheses };
    let Some(start) = start else { return Err(no_consensus(0)) };
    let seen = matches.visible_from(&start.pose);
    let test = CameraTest {
        known: focal,
        map: problem.map_cameras,
        with_evidence: options.camera_evidence,
        estimate_noise: options.estimate_noise,
    };
    let FocalRefinement { search, polished, factor, verdict } =
        FocalRefinement::new(search, &seen, &start, &test);
    let camera = CameraRefinement::new(search, &seen, polished, factor, verdict, &test);
    let CameraRefinement { search, polished, change, covariance: camera_covariance, focal: verdict, .. } =
        camera;
    let focal_sd = (verdict == FocalVerdict::Wrong && search.is_likelihood()).then(|| focal.sd());
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
    let focal_gain = match verdict {
        FocalVerdict::Wrong if focal == FocalPrior::Calibrated => {
            FocalVerdict::min_gain(matches.observations, inliers.len())
        }
        _ => verdict.suspected_gain(),
    };
    let design_effect = search.design_effect(&polished.pose, &likelihoods, polished.noise);
    let uncertainty = |known: &PosePriors, free, design_effect| {
        let agreement = Agreement { likelihoods: &likelihoods, inliers: &inliers, design_effect };
        search.uncertainty(known, &polished, &agreement, focal_sd, free)
    };
    // What holds the pose are the matches: camera priors never increase it.
    let nothing = PosePriors::default();
    let (noise_px, mut independent) = uncertainty(&nothing, None, 1.0);
    let free = free_direction(matches, &polished.pose, &inliers, &likelihoods, &independent);
    if free.is_some() {
        independent = uncertainty(&nothing, free, 1.0).1;
    }
    let margin = search.margin(&polished, &independent, options.estimate_noise);
    let with_camera = |of: &Symmetric6| sum(of, &camera_covariance);
    let mut confidence = assess(matches, &polished.pose, &inliers, &likelihoods, &independent, margin);
    let known = search.priors();
    let mut by_matches = uncertainty(&nothing, free, design_effect).1;
    let gravity_test = problem.gravity.as_ref().filter(|_| search.is_likelihood()).map(|gravity| {
        let test = GravityTest::new(gravity, &polished.pose);
        if known.has_gravity() { test.without_influence(&independent) } else { test }
    });
    confidence.gravity = gravity_test.map(|test| test.judge(&with_camera(&by_matches)));
    // Only a gravity direction that the matches confirm makes the ± smaller.
    let is_confirmed = confidence.gravity.is_some_and(|gravity| gravity.log_evidence > 0.0);
    let confirmed = if is_confirmed { known.clone() } else { known.without_gravity() };
    let mut covariance =
        if confirmed.is_empty() { by_matches } else { uncertainty(&confirmed, free, design_effect).1 };
    (covariance, by_matches) = (with_camera(&covariance), with_camera(&by_matches));
    confidence = confidence.with_covariances(&covariance, &by_matches);
    confidence.position_deviation = known.position_deviation(&polished.pose, position_sd(&by_matches));
    if let FocalVerdict::Suspicious { other, .. } = verdict {
        let shift = polished.pose.step_to(&other.pose);
        (covariance, by_matches) = (with_shift(&covariance, &shift), with_shift(&by_matches, &shift));
        confidence = confidence.with_covariances(&covariance, &by_matches);
        confidence.other_focal = verdict.suspected_focal_scale(problem.map_cameras.min_focal_gain);
    }
    confidence.is_camera_contradicted = camera.is_contradicted;
    if let Some((direction, _)) = free {
        covariance = free_along(&covariance, &direction);
        by_matches = free_along(&by_matches, &direction);
        confidence = confidence.with_free_direction();
    }
    Ok(PoseEstimate {
        cam_from_world: polished.pose,
        inlier_count: inliers.len(),
        inlier_keypoints,
        hypotheses,
        score: search.cost(&polished.pose, f64::INFINITY),
        noise_px,
        focal_scale: change.factor(),
        principal_shift_px: change.principal_shift_px(&seen.camera),
        camera_covariance,
        camera_evidence: camera.evidence.map(|evidence| CameraEvidence { focal_gain, ..evidence }),
        gravity_test,
        covariance,
        covariance_by_matches: by_matches,
        confidence,
        free_direction: free.map(|(d, _)| (polished.pose.rotation().inverse() * d).into()),
        inliers: mask,
        rival: None,
        refined: polished.accepted,
    })
}
