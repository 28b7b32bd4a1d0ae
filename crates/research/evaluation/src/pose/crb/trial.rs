//! One synthetic problem under one scheme: what the estimator found, and what the bound allows.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_obfuscation::obfuscate_points;
use veiloc_pose::{PoseEstimate, PoseProblem, estimate_pose, fisher_information};
use veiloc_protocol::Scheme;
use veiloc_synthetic::problems::PointProblem;

use super::{Condition, SyntheticEvaluation, bound, noise};
use crate::pose::evaluate::pose_problem;
use crate::pose::floor::runs_through;
use crate::results::coverage::NormalizedError;
use crate::results::metrics::PoseError;
use veiloc_datasets::problem_files::Problem;
use veiloc_datasets::problem_files::seed_for;

/// Draws from the bound a problem: many problems make the median smooth, not many draws of one.
const DRAWS: usize = 16;

/// A pose that at least this share of the truly right correspondences agrees with was found.
const FOUND_SHARE: f64 = 0.5;

/// What came of one problem.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    /// Of the estimate; [`PoseError::NOT_LOCALIZED`] without.
    pub(super) error: PoseError,
    /// Errors the bound predicts; empty when the right matches do not hold the pose.
    pub(super) predicted: Vec<PoseError>,
    /// Whether there is an estimate.
    pub(super) localized: bool,
    /// Share of the truly right correspondences that the estimate calls inliers.
    pub(super) inliers_found: f64,
    /// Errors in units of the estimated covariance.
    pub(super) normalized: NormalizedError,
}

impl Trial {
    /// Whether the search came to the right place, so that the rest is a matter of precision.
    pub(super) fn found(&self) -> bool {
        self.localized && self.inliers_found >= FOUND_SHARE
    }
}

/// Draws the problem, hides its keypoints and estimates the pose. Every scheme sees the same keypoints.
pub(super) fn run(
    evaluation: &SyntheticEvaluation,
    condition: &Condition,
    scheme: Scheme,
    index: usize,
) -> Trial {
    let name = format!("{} {} {} {index}", condition.scene, condition.noise_px, condition.outlier_share);
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&name]));
    let options = condition
        .scene
        .problems(evaluation.matches)
        .noise(condition.noise_px)
        .outliers(condition.outlier_share);
    let synthetic = PointProblem::generate(&options, &mut rng);
    let problem = as_problem(&name, &synthetic);

    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&name, &scheme.to_string()]));
    let camera = &problem.camera;
    let unsolved = Trial {
        error: PoseError::NOT_LOCALIZED,
        predicted: Vec::new(),
        localized: false,
        inliers_found: 0.0,
        normalized: NormalizedError::NOT_LOCALIZED,
    };
    let hidden = obfuscate_points(
        &problem.keypoints,
        camera.width,
        camera.height,
        &scheme,
        evaluation.angle_bits,
        &mut rng,
    );
    let Ok(observations) = hidden else { return unsolved };
    let (pose_problem, match_of) = pose_problem(&problem, &observations, false);
    let right: Vec<bool> = match_of
        .iter()
        .enumerate()
        .map(|(i, &m)| synthetic.inliers[m] && runs_through(&pose_problem, i, problem.keypoints[m]))
        .collect();
    let predicted = predict(evaluation, condition, &synthetic, &pose_problem, &right, &mut rng);
    match estimate_pose(&pose_problem, &evaluation.pose, &mut rng) {
        Ok(estimate) => Trial { predicted, ..judge(&estimate, &synthetic, &right) },
        Err(_) => Trial { predicted, ..unsolved },
    }
}

fn predict(
    evaluation: &SyntheticEvaluation,
    condition: &Condition,
    truth: &PointProblem,
    problem: &PoseProblem,
    right: &[bool],
    rng: &mut ChaCha8Rng,
) -> Vec<PoseError> {
    let pose = &truth.cam_from_world;
    let noise = noise::observation_noise(problem, pose, right, condition.noise_px, evaluation.angle_bits);
    fisher_information(problem, pose, right, noise)
        .ok()
        .and_then(|information| bound::predicted_errors(pose, &information, DRAWS, rng))
        .unwrap_or_default()
}

fn judge(estimate: &PoseEstimate, truth: &PointProblem, right: &[bool]) -> Trial {
    let pose = &estimate.cam_from_world;
    let all = right.iter().filter(|r| **r).count();
    let agreed = right.iter().zip(&estimate.inliers).filter(|(right, inlier)| **right && **inlier).count();
    Trial {
        error: PoseError::of(pose, &truth.cam_from_world),
        predicted: Vec::new(),
        localized: true,
        inliers_found: agreed as f64 / all.max(1) as f64,
        normalized: NormalizedError::of(pose, &estimate.covariance, &truth.cam_from_world),
    }
}

/// The generated problem as if it had been read from a file: every match has a keypoint of its own.
pub(super) fn as_problem(name: &str, synthetic: &PointProblem) -> Problem {
    Problem {
        name: name.to_owned(),
        camera: synthetic.camera,
        keypoints: synthetic.pixels.clone(),
        keypoint_of_match: (0..synthetic.pixels.len()).collect(),
        points: synthetic.points.clone(),
        cam_from_world: synthetic.cam_from_world,
        features: "none".to_owned(),
        ratio: None,
        votes: None,
        track_length: None,
        seen_from: None,
        gravity: None,
    }
}
