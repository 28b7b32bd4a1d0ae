//! One synthetic problem under one scheme: the estimate and the bound.

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
use crate::results::metrics::PoseErrors;
use veiloc_datasets::problem_files::Problem;
use veiloc_datasets::problem_files::seed_for;

/// Samples from the bound per problem: the number of problems, not of samples, makes the median smooth.
const DRAWS: usize = 16;

/// Smallest share of the true correspondences that must agree with a pose for it to be found.
const FOUND_SHARE: f64 = 0.5;

/// Results of one problem.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    /// Error of the estimate; [`PoseErrors::NOT_LOCALIZED`] without an estimate.
    pub(super) error: PoseErrors,
    /// Errors that the bound predicts; empty when the true matches do not determine the pose.
    pub(super) predicted: Vec<PoseErrors>,
    /// Whether there is an estimate.
    pub(super) localized: bool,
    /// Share of the true correspondences among the estimate's inliers.
    pub(super) inlier_recall: f64,
    /// Errors in units of the estimated covariance, without its part from the camera, which is exact here.
    pub(super) normalized: NormalizedError,
}

impl Trial {
    /// Whether the search found the right optimum, so that the remaining error is one of precision.
    pub(super) fn found(&self) -> bool {
        self.localized && self.inlier_recall >= FOUND_SHARE
    }
}

/// Generates the problem, obfuscates its keypoints and estimates the pose. Every scheme gets the same keypoints.
pub(super) fn run(
    evaluation: &SyntheticEvaluation,
    condition: &Condition,
    scheme: Scheme,
    index: usize,
) -> Trial {
    let name = format!("{} {} {} {index}", condition.scene, condition.noise_px, condition.outlier_ratio);
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&name]));
    let options = condition
        .scene
        .problems(evaluation.matches)
        .noise(condition.noise_px)
        .outliers(condition.outlier_ratio);
    let synthetic = PointProblem::generate(&options, &mut rng);
    let problem = as_problem(&name, &synthetic);

    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&name, &scheme.to_string()]));
    let camera = &problem.camera;
    let unsolved = Trial {
        error: PoseErrors::NOT_LOCALIZED,
        predicted: Vec::new(),
        localized: false,
        inlier_recall: 0.0,
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
        Ok(estimate) => Trial { predicted, ..assess(&estimate, &synthetic, &right) },
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
) -> Vec<PoseErrors> {
    let pose = &truth.cam_from_world;
    let noise = noise::observation_noise(problem, pose, right, condition.noise_px, evaluation.angle_bits);
    fisher_information(problem, pose, right, noise)
        .ok()
        .and_then(|information| bound::predicted_errors(pose, &information, DRAWS, rng))
        .unwrap_or_default()
}

fn assess(estimate: &PoseEstimate, truth: &PointProblem, right: &[bool]) -> Trial {
    let pose = &estimate.cam_from_world;
    let all = right.iter().filter(|r| **r).count();
    let agreed = right.iter().zip(&estimate.inliers).filter(|(right, inlier)| **right && **inlier).count();
    Trial {
        error: PoseErrors::of(pose, &truth.cam_from_world),
        predicted: Vec::new(),
        localized: true,
        inlier_recall: agreed as f64 / all.max(1) as f64,
        normalized: NormalizedError::of(pose, &estimate.noise_covariance(), &truth.cam_from_world),
    }
}

/// The generated problem in the form of one read from a file: every match has its own keypoint.
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
