//! Matches that support a second pose: an object that was moved, and places that look alike.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::rigs::{ODOMETRY, session};
use support::{Scheme, Setup, problem};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Point3};
use veiloc_pose::{
    Correspondences, Doubt, PoseEstimate, PoseOptions, PoseProblem, PositionPrior, State, estimate_pose,
    estimate_rig_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// From the mapped position of an object to the one at which the query sees it, map units.
const MOVED: Vector3<f64> = Vector3::new(1.0, 0.3, -0.4);

fn estimate(problem: &PoseProblem, seed: u64) -> PoseEstimate {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    estimate_pose(problem, &PoseOptions::default(), rng).expect("a pose")
}

fn has_rival(estimate: &PoseEstimate) -> bool {
    estimate.confidence.doubts().iter().any(|doubt| matches!(doubt, Doubt::Rival { .. }))
}

/// The right matches of a scene, of which the first ones are on an object that was moved since it was mapped.
fn moved_object(
    scheme: Scheme,
    [moved, fixed, wrong]: [usize; 3],
    seed: u64,
) -> (PoseProblem, CameraFromWorld) {
    let setup = Setup { scheme, right: moved + fixed, wrong, noise: 1.0 };
    let (mut problem, truth) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(seed));
    for point in &mut problem.points[..moved] {
        *point = Point3::from_vector(point.coords - MOVED);
    }
    (problem, truth)
}

#[test]
fn moved_object_with_most_matches_makes_the_pose_doubtful() {
    for scheme in SCHEMES {
        for seed in 0..4 {
            let (problem, truth) = moved_object(scheme, [200, 140, 60], seed);
            let found = estimate(&problem, seed);
            assert_eq!(found.confidence.state(), State::Doubtful, "{scheme:?} {seed}");
            assert!(has_rival(&found), "{scheme:?} {seed}: {:?}", found.confidence);
            // The pose itself is that of the object, whose matches are more.
            assert!(found.cam_from_world.translation_error(&truth) > 0.5, "{scheme:?} {seed}");
        }
    }
}

#[test]
fn small_moved_object_leaves_the_pose_trusted() {
    for scheme in SCHEMES {
        for seed in 0..4 {
            let (problem, truth) = moved_object(scheme, [12, 250, 150], seed);
            let found = estimate(&problem, seed);
            assert_eq!(found.confidence.state(), State::Trusted, "{scheme:?} {seed}: {:?}", found.confidence);
            assert!(found.cam_from_world.translation_error(&truth) < 0.05, "{scheme:?} {seed}");
        }
    }
}

/// A place of which a copy with fewer points exists at another position: some keypoints have a match in both.
fn partial_copy(scheme: Scheme, copied: usize, seed: u64) -> (PoseProblem, CameraFromWorld) {
    let setup = Setup { scheme, right: 200, wrong: 100, noise: 1.0 };
    let (mut problem, truth) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(seed));
    copy(&mut problem, copied);
    (problem, truth)
}

/// Gives the keypoints of the first matches a second match each, in the copy.
fn copy(problem: &mut PoseProblem, copied: usize) {
    let copies: Vec<_> =
        problem.points[..copied].iter().map(|p| Point3::from_vector(p.coords + 30.0 * MOVED)).collect();
    problem.points.extend(copies);
    problem.keypoints.extend_from_within(..copied);
    match &mut problem.observations {
        Correspondences::Points { pixels } => pixels.extend_from_within(..copied),
        Correspondences::Lines { lines } => lines.extend_from_within(..copied),
        Correspondences::Anchored { lines, .. } => lines.extend_from_within(..copied),
    }
}

#[test]
fn copy_of_a_place_with_fewer_points_makes_the_pose_doubtful() {
    for scheme in SCHEMES {
        for seed in 0..4 {
            let (problem, truth) = partial_copy(scheme, 90, seed);
            let found = estimate(&problem, seed);
            assert!(found.cam_from_world.translation_error(&truth) < 0.1, "{scheme:?} {seed}");
            assert!(has_rival(&found), "{scheme:?} {seed}: {:?}", found.confidence);
            // The copy has less than half of the matches: its difference alone is no doubt.
            assert!(found.confidence.margin > 50.0, "{scheme:?} {seed}: {:?}", found.confidence);
        }
    }
}

#[test]
fn copy_of_a_place_makes_the_pose_of_a_session_doubtful() {
    for scheme in SCHEMES {
        for copied in [0, 60] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let setup = Setup { scheme, right: 120, wrong: 60, noise: 1.0 };
            let (mut frames, truth) = session(&setup, 3, ODOMETRY, &mut rng);
            for frame in &mut frames {
                copy(&mut frame.problem, copied);
            }
            let found = estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng).expect("a pose");
            assert!(found.rig_from_world.translation_error(&truth) < 0.1, "{scheme:?} {copied}");
            let expected = if copied > 0 { State::Doubtful } else { State::Trusted };
            assert_eq!(found.confidence.state(), expected, "{scheme:?} {copied}: {:?}", found.confidence);
        }
    }
}

#[test]
fn session_far_from_the_given_position_is_doubtful() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let setup = Setup { scheme: Scheme::Dcl, right: 120, wrong: 60, noise: 1.0 };
    let (mut frames, _) = session(&setup, 3, ODOMETRY, &mut rng);
    let center = estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng).expect("a pose").frames[0]
        .cam_from_world
        .center();
    for (deviations, state) in [(2.0, State::Trusted), (10.0, State::Doubtful)] {
        let center = Point3::from_vector(center.coords + Vector3::new(0.0, deviations, 0.0));
        frames[0].problem.position = Some(PositionPrior { center, sd: 1.0 });
        let found = estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng).expect("a pose");
        assert_eq!(found.confidence.state(), state, "{deviations}: {:?}", found.confidence);
    }
}

#[test]
fn wrong_matches_are_no_rival() {
    for scheme in SCHEMES {
        for seed in 0..4 {
            let setup = Setup { scheme, right: 120, wrong: 400, noise: 1.0 };
            let (problem, _) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(seed));
            let found = estimate(&problem, seed);
            assert!(!has_rival(&found), "{scheme:?} {seed}: {:?}", found.confidence);
        }
    }
}

#[test]
fn pose_far_from_the_given_position_is_doubtful() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 140, wrong: 60, noise: 1.0 };
        let (mut problem, truth) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(7));
        for (deviations, state) in [(2.0, State::Trusted), (10.0, State::Doubtful)] {
            let center = Point3::from_vector(truth.center().coords + Vector3::new(deviations, 0.0, 0.0));
            problem.position = Some(PositionPrior { center, sd: 1.0 });
            let found = estimate(&problem, 1);
            assert!(found.cam_from_world.translation_error(&truth) < 0.05, "{scheme:?} {deviations}");
            assert_eq!(found.confidence.state(), state, "{scheme:?} {deviations}: {:?}", found.confidence);
        }
    }
}
