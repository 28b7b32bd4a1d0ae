//! `veiloc eval pose`: the pose stage alone, on given matches.
//!
//! The keypoints of each query are obfuscated when they are read, each keypoint once for all its matches. So all
//! schemes have the same matches, and only the positions given to the server differ. With one seed, all estimators
//! get the same lines.

use std::path::PathBuf;
use std::time::Instant;

use crate::EvalError;
use crate::pose::estimator::{Estimator, TruthStart, common_hypotheses};
use crate::pose::floor::{ORACLE_RADIUS_PX, true_matches};
use crate::pose::gravity::{GravitySource, mean_down, simulated_reading};
use crate::results::metrics::Threshold;
use crate::results::{EstimatorVariant, EvaluationDocument, QueryResult, QueryUncertainty, summarize};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_datasets::problem_files::json_lines;
use veiloc_datasets::problem_files::problems::{Problem, read_problems};
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::Progress;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_localization::{MatchedObservations, observe_matches};
use veiloc_obfuscation::obfuscate_points;
use veiloc_pose::{PoseProblem, State, estimate_pose, optimize_pose, refine_pose};
use veiloc_protocol::{AngleBits, Observations, Scheme};

/// Inputs and options.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PoseEvaluation {
    /// Files of problems.
    pub files: Vec<PathBuf>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Estimators, in the order of the table; not empty. Retrieval and matching do not apply.
    pub estimators: Vec<Estimator>,
    /// Sources of gravity, in the order of the table; not empty.
    pub gravity: Vec<GravitySource>,
    /// For `floor`, a match is true when its map point projects within this distance of the keypoint under
    /// the true pose, pixels. Default: 4, the paper's inlier threshold for images of this size.
    pub oracle_radius_px: f64,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Bits of a line's angle.
    pub angle_bits: AngleBits,
    /// First seed of obfuscation and sampling.
    pub seed: u64,
    /// Number of seeds, consecutive; at least one.
    pub seeds: u64,
    /// Queries that are estimated in parallel. More than one increases the times of a query.
    pub threads: usize,
}

impl PoseEvaluation {
    /// The default estimator on these files under these schemes, with one seed.
    pub fn new(files: Vec<PathBuf>, schemes: Vec<Scheme>) -> Self {
        Self {
            files,
            schemes,
            estimators: vec![Estimator::default()],
            gravity: vec![GravitySource::File],
            oracle_radius_px: ORACLE_RADIUS_PX,
            thresholds: Vec::new(),
            angle_bits: AngleBits::default(),
            seed: 0,
            seeds: 1,
            threads: 1,
        }
    }
}

/// A problem, with properties of its whole file.
struct Query {
    problem: Problem,
    /// Down direction in the file's world, see [`gravity::mean_down`].
    down: Vector3<f64>,
}

/// One row of the table.
struct Row<'a> {
    scheme: Scheme,
    estimator: &'a Estimator,
    gravity: GravitySource,
    variant: EstimatorVariant,
}

/// Runs every row on every problem under every seed.
///
/// # Errors
/// [`EvalError`] when a file cannot be read or the options select nothing. A problem without a solution is a result,
/// not an error.
pub fn evaluate_poses(
    evaluation: &PoseEvaluation,
    progress: &dyn Progress,
) -> Result<EvaluationDocument, EvalError> {
    let mut queries = Vec::new();
    for file in &evaluation.files {
        let problems = read_problems(file)?;
        let down = mean_down(problems.iter().map(|p| &p.cam_from_world));
        queries.extend(problems.into_iter().map(|problem| Query { problem, down }));
    }
    let rows = rows(evaluation, queries.iter().any(|q| q.problem.gravity.is_some()));
    if rows.is_empty() || evaluation.seeds == 0 {
        return Err(EvalError::Options("no scheme, estimator, gravity or seed to evaluate".to_owned()));
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(evaluation.threads.max(1))
        .build()
        .map_err(|e| EvalError::Options(format!("{} threads: {e}", evaluation.threads)))?;

    let total = rows.len() * queries.len() * usize::try_from(evaluation.seeds).unwrap_or(usize::MAX);
    progress.start("Estimating poses", total);
    let mut results: Vec<QueryResult> = Vec::with_capacity(total);
    let mut schemes = Vec::new();
    for row in &rows {
        let first = results.len();
        for seed in evaluation.seed..evaluation.seed.saturating_add(evaluation.seeds) {
            let one = |query: &Query| {
                let result = solve(query, row, seed, evaluation);
                progress.advance(1);
                result
            };
            if evaluation.threads > 1 {
                results.extend(pool.install(|| queries.par_iter().map(one).collect::<Vec<_>>()));
            } else {
                results.extend(queries.iter().map(one));
            }
        }
        let of_row: Vec<&QueryResult> = results[first..].iter().collect();
        schemes.push(summarize(&of_row, &evaluation.thresholds));
    }
    progress.finish();
    Ok(EvaluationDocument {
        version: 1,
        command: "eval pose",
        data: evaluation.files.iter().map(|f| json_lines::display_name(f)).collect(),
        seed: evaluation.seed,
        prior: evaluation.estimators.iter().any(|estimator| estimator.localize.use_prior),
        fixed_hypotheses: common_hypotheses(&evaluation.estimators),
        schemes,
        queries: results,
        map: None,
        sparse_map: None,
    })
}

/// All rows: schemes × estimators × gravity.
fn rows(evaluation: &PoseEvaluation, file_has_gravity: bool) -> Vec<Row<'_>> {
    let mut rows = Vec::new();
    for &scheme in &evaluation.schemes {
        for estimator in &evaluation.estimators {
            // Without a search all sources of gravity give the same row.
            let sources = if estimator.searches() { usize::MAX } else { 1 };
            for &gravity in evaluation.gravity.iter().take(sources) {
                let has_gravity = gravity != GravitySource::File || file_has_gravity;
                let used = (has_gravity && estimator.searches()).then(|| gravity.to_string());
                let variant = EstimatorVariant { gravity: used, ..estimator.variant() };
                rows.push(Row { scheme, estimator, gravity, variant });
            }
        }
    }
    rows
}

fn solve(query: &Query, row: &Row<'_>, seed: u64, evaluation: &PoseEvaluation) -> QueryResult {
    let Query { problem, down } = query;
    let (from_truth, options) = (row.estimator.from_truth, &row.estimator.localize.pose);
    let blank = || {
        let mut result = QueryResult::unsolved(&problem.name, row.scheme, row.estimator.score());
        result.variant = row.variant.clone();
        result.seed = seed;
        if from_truth == Some(TruthStart::Floor) {
            "least-squares".clone_into(&mut result.score);
        }
        result
    };
    // The same lines for all rows of a scheme: the seed depends on query and scheme, not on the position in the file.
    let names = [problem.name.as_str(), &row.scheme.to_string()];
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &names));
    let (width, height) = (problem.camera.width, problem.camera.height);
    let obfuscated =
        obfuscate_points(&problem.keypoints, width, height, &row.scheme, evaluation.angle_bits, &mut rng);
    let observations = match obfuscated {
        Ok(observations) => observations,
        // The keypoint is too far outside the image for any line code, so the query cannot be sent.
        Err(error) => return blank().because(&error),
    };
    let (mut pose_problem, _) = pose_problem(problem, &observations, row.variant.prior);
    pose_problem.gravity = match row.gravity {
        GravitySource::File => problem.gravity,
        GravitySource::Ignored => None,
        GravitySource::TrueTurned(degrees) => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[&problem.name, "gravity"]));
            Some(simulated_reading(&problem.cam_from_world, *down, degrees, &mut rng))
        }
    };
    let truth = &problem.cam_from_world;
    let right = (from_truth == Some(TruthStart::Floor))
        .then(|| true_matches(&pose_problem, truth, &problem.keypoints, evaluation.oracle_radius_px));

    let started = Instant::now();
    let estimate = match (from_truth, &right) {
        (_, Some(right)) => refine_pose(&pose_problem, truth, right, options),
        (Some(TruthStart::Optimum), _) => optimize_pose(&pose_problem, truth, options),
        _ => estimate_pose(&pose_problem, options, &mut rng),
    };
    let pose_ms = started.elapsed().as_secs_f64() * 1e3;

    let mut result = blank();
    result.correspondences = pose_problem.points.len();
    result.ms.insert("pose".to_owned(), pose_ms);
    match estimate {
        Ok(estimate) => {
            result = result.found(&estimate.cam_from_world, truth);
            result.inliers = estimate.inlier_count;
            result.hypotheses = estimate.hypotheses;
            // Trust is meaningless for an estimate that starts from the truth.
            if from_truth.is_none() {
                result = result.judged(estimate.confidence.state(), &estimate.confidence);
            }
            let covariance = &estimate.covariance;
            result.uncertainty = Some(QueryUncertainty::of(&estimate.cam_from_world, covariance, truth));
        }
        Err(error) => {
            result = result.because(&error);
            result.state = from_truth.is_none().then_some(State::NotFound);
        }
    }
    result
}

/// The estimator's input, and the match behind each of its correspondences.
pub fn pose_problem(
    problem: &Problem,
    observations: &Observations,
    use_prior: bool,
) -> (PoseProblem, Vec<usize>) {
    let MatchedObservations { correspondences, keypoints, match_of } =
        observe_matches(observations, &problem.keypoint_of_match);
    let prior = use_prior.then(|| problem.prior()).flatten();
    let points = match_of.iter().map(|&m| problem.points[m]).collect();
    let mut pose_problem = PoseProblem::new(problem.camera, correspondences, keypoints, points);
    pose_problem.seen_from = problem.seen_from.as_ref().map(|s| match_of.iter().map(|&m| s[m]).collect());
    pose_problem.prior = prior.map(|p| match_of.iter().map(|&m| p[m]).collect());
    (pose_problem, match_of)
}
