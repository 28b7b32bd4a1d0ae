//! `veiloc eval pose`: the pose stage alone, on matches that are already there.
//!
//! Each query's keypoints are obfuscated on reading, each keypoint once however many matches it has, so that all
//! schemes see the very same matches and only what the server is told about positions differs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_localize::{MatchedObservations, observe_matches};
use veiloc_obfuscation::obfuscate_points;
use veiloc_query::{AngleBits, Observations, Scheme};
use veiloc_robust::{PoseOptions, PoseProblem, ScoreKind, estimate_pose};

use crate::error::EvalError;
use crate::metrics::Threshold;
use crate::problems::{Problem, read_problems};
use crate::results::{Evaluation, QueryResult, summarize};
use crate::scene::scores_for;
use crate::seeds::seed_for;

/// What to evaluate.
#[derive(Debug, Clone)]
pub struct PoseEvaluation {
    /// Files of problems.
    pub files: Vec<PathBuf>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Scores, in the order of the table; empty for each scheme's own default.
    pub scores: Vec<ScoreKind>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Robust estimation; its score is replaced by each of [`Self::scores`].
    pub pose: PoseOptions,
    /// Bits of a line's angle.
    pub angle_bits: AngleBits,
    /// Whether matches are weighted by what their ratio, votes and track length say.
    pub use_prior: bool,
    /// Seed of obfuscation and sampling.
    pub seed: u64,
}

/// Runs every scheme and score on every problem; `advance` is called once a problem, scheme and score.
///
/// # Errors
/// [`EvalError`] when a file cannot be read. A problem that cannot be solved is a result, not an error.
pub fn evaluate_poses(
    evaluation: &PoseEvaluation,
    mut advance: impl FnMut(usize, usize),
) -> Result<Evaluation, EvalError> {
    let mut problems = Vec::new();
    for file in &evaluation.files {
        problems.extend(read_problems(file)?);
    }
    let recipes: Vec<(Scheme, ScoreKind)> = evaluation
        .schemes
        .iter()
        .flat_map(|scheme| scores_for(*scheme, &evaluation.scores).into_iter().map(|score| (*scheme, score)))
        .collect();

    let total = recipes.len() * problems.len();
    let mut queries = Vec::with_capacity(total);
    let mut schemes = Vec::new();
    for (scheme, score) in recipes {
        let first = queries.len();
        for problem in &problems {
            queries.push(solve(problem, scheme, score, evaluation));
            advance(queries.len(), total);
        }
        let of_recipe: Vec<&QueryResult> = queries[first..].iter().collect();
        schemes.push(summarize(&of_recipe, &evaluation.thresholds));
    }
    Ok(Evaluation {
        version: 1,
        command: "eval pose",
        data: evaluation.files.iter().map(|f| display_name(f)).collect(),
        seed: evaluation.seed,
        prior: evaluation.use_prior,
        fixed_hypotheses: evaluation.pose.fixed_hypotheses,
        schemes,
        queries,
        map: None,
    })
}

fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

fn solve(problem: &Problem, scheme: Scheme, score: ScoreKind, evaluation: &PoseEvaluation) -> QueryResult {
    // The same lines for both scores and any order of schemes: the seed names query and scheme, not the position.
    let seed = seed_for(evaluation.seed, &[&problem.name, &scheme.to_string()]);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (width, height) = (problem.camera.width, problem.camera.height);
    let observations =
        match obfuscate_points(&problem.keypoints, width, height, &scheme, evaluation.angle_bits, &mut rng) {
            Ok(observations) => observations,
            // A keypoint so far outside the picture that no line code reaches it: the query cannot be sent.
            Err(error) => return QueryResult::unsolved(&problem.name, scheme, score).because(&error),
        };
    let pose_problem = pose_problem(problem, &observations, evaluation.use_prior);
    let mut options = evaluation.pose.clone();
    options.score = Some(score);

    let started = Instant::now();
    let estimate = estimate_pose(&pose_problem, &options, &mut rng);
    let pose_ms = started.elapsed().as_secs_f64() * 1e3;

    let mut result = QueryResult::unsolved(&problem.name, scheme, score);
    result.correspondences = pose_problem.points.len();
    result.ms.insert("pose".to_owned(), pose_ms);
    match estimate {
        Ok(estimate) => {
            result = result.found(&estimate.cam_from_world, &problem.cam_from_world);
            result.inliers = estimate.inlier_count;
            result.hypotheses = estimate.hypotheses;
        }
        Err(error) => result = result.because(&error),
    }
    result
}

/// The estimator's input.
fn pose_problem(problem: &Problem, observations: &Observations, use_prior: bool) -> PoseProblem {
    let MatchedObservations { correspondences, match_of } =
        observe_matches(observations, &problem.keypoint_of_match);
    let prior = use_prior.then(|| problem.prior()).flatten();
    PoseProblem {
        camera: problem.camera,
        observations: correspondences,
        points: match_of.iter().map(|&m| problem.points[m]).collect(),
        prior: prior.map(|p| match_of.iter().map(|&m| p[m]).collect()),
        gravity: None,
    }
}
