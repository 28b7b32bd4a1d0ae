//! A user-defined scheme, evaluated before it becomes part of the protocol: pose accuracy and leakage.
//!
//! Keypoints of the left half become vertical lines, those of the right half horizontal ones.

use std::f64::consts::FRAC_PI_2;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc::geometry::{Pixel, PixelLine};
use veiloc::protocol::Observations;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, NeighbourLists, Observation, closed_form, errors_px, prior_only,
};
use veiloc_evaluation::pose::pose_problem;
use veiloc_pose::{PoseOptions, estimate_pose};
use veiloc_synthetic::problems::{PointProblem, PointProblemOptions};

/// The scheme: from keypoints to sent lines. Positions along the lines are not used.
fn vertical_and_horizontal(keypoints: &[Pixel], width: u32) -> Observations {
    let angle = |p: &Pixel| if p.u < f64::from(width) / 2.0 { FRAC_PI_2 } else { 0.0 };
    Observations::Lines(keypoints.iter().map(|p| PixelLine::through(*p, angle(p))).collect())
}

#[test]
fn user_defined_scheme_is_evaluated_by_poses_and_attacks() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let options = PointProblemOptions::exact(300).noise(0.7).outliers(0.4);
    let made = PointProblem::generate(&options, &mut rng);
    let (width, height) = (made.camera.width, made.camera.height);
    let observations = vertical_and_horizontal(&made.pixels, width);

    // Pose accuracy.
    let problem = veiloc_datasets::problem_files::Problem {
        name: "made".to_owned(),
        camera: made.camera,
        keypoints: made.pixels.clone(),
        keypoint_of_match: (0..made.pixels.len()).collect(),
        points: made.points.clone(),
        cam_from_world: made.cam_from_world,
        features: "sift".to_owned(),
        ratio: None,
        votes: None,
        track_length: None,
        seen_from: None,
        gravity: None,
    };
    let (input, _) = pose_problem(&problem, &observations, false);
    let found = estimate_pose(&input, &PoseOptions::default(), &mut rng).expect("a pose");
    assert!(found.confidence.is_trusted());
    assert!(found.cam_from_world.rotation_error_degrees(&made.cam_from_world) < 0.5);

    // Leakage: the paper's attack with true neighbours, beside the prior-only baseline.
    let sent = Observation::of_sent(&observations);
    let near = NeighbourLists::nearest(&made.pixels, 20);
    let answers = closed_form(&sent, &near, width, height, &ClosedFormOptions::default()).expect("it runs");
    let median = |answers: Vec<Pixel>| ErrorSummary::of(&errors_px(answers, &made.pixels)).median_px;
    let attacked = median(answers.iter().map(|a| a.pixel).collect());
    let prior = median(prior_only(&sent, width, height));
    // Lines of one half are parallel and do not intersect: the attack gains nothing over the baseline.
    assert!(attacked > 0.8 * prior && prior > 30.0, "{attacked} {prior}");
}
