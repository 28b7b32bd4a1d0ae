//! Duplicates among the matches: the same match many times, and many matches on one spot, count as few.

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, gauss, problem};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromRig, CameraFromWorld, PixelLine, Point3};
use veiloc_pose::{
    Correspondences, PoseOptions, PoseProblem, RigFrame, State, estimate_pose, estimate_rig_pose,
    optimize_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

const SETUP: Setup = Setup { scheme: Scheme::Points, right: 140, wrong: 60, noise: 1.0 };

/// Adds a match of the keypoint of `of` with its map point, both moved by noise of this size. A line of any direction
/// gets a new direction, as when one keypoint is sealed several times.
fn add(problem: &mut PoseProblem, of: usize, spot_px: f64, spot: f64, rng: &mut ChaCha8Rng) {
    match &mut problem.observations {
        Correspondences::Points { pixels } => {
            let mut pixel = pixels[of];
            pixel.u += spot_px * gauss(rng);
            pixel.v += spot_px * gauss(rng);
            pixels.push(pixel);
        }
        Correspondences::Lines { lines } => {
            // Through the pixel of the line that is nearest to the image's middle.
            let line = *lines[of].coefficients();
            let offset = line.x * 320.0 + line.y * 240.0 + line.z;
            let pixel = veiloc_geometry::Pixel::new(320.0 - offset * line.x, 240.0 - offset * line.y);
            lines.push(PixelLine::through(pixel, rng.random_range(0.0..std::f64::consts::PI)));
        }
        Correspondences::Anchored { lines, .. } => {
            let (anchor, angle) = lines[of];
            lines.push((anchor, angle + spot_px / 240.0 * gauss(rng)));
        }
    }
    problem.keypoints.push(problem.points.len());
    let moved = problem.points[of].coords + Vector3::from_fn(|_, _| spot * gauss(rng));
    problem.points.push(Point3::from_vector(moved));
}

/// The state of the estimate, and its error in standard deviations and in map units.
fn outcome(problem: &PoseProblem, truth: &CameraFromWorld, rng: &mut ChaCha8Rng) -> (State, f64) {
    match estimate_pose(problem, &PoseOptions::default(), rng) {
        Ok(estimate) => (estimate.confidence.state(), estimate.cam_from_world.translation_error(truth)),
        Err(_) => (State::NotFound, f64::INFINITY),
    }
}

#[test]
fn duplicates_of_a_wrong_match_do_not_hide_the_pose() {
    for scheme in SCHEMES {
        for (seed, duplicates) in [(1, 80), (2, 120), (3, 150), (4, 300)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut problem, truth) = problem(&Setup { scheme, ..SETUP }, &mut rng);
            for _ in 0..duplicates {
                add(&mut problem, 170, 0.0, 0.0, &mut rng);
            }
            let (state, error) = outcome(&problem, &truth, &mut rng);
            assert!(state == State::Trusted && error < 0.05, "{scheme:?} x{duplicates}: {state} {error}");
        }
    }
}

#[test]
fn duplicates_of_all_wrong_matches_do_not_hide_the_pose() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let (mut problem, truth) = problem(&Setup { scheme, ..SETUP }, &mut rng);
        for of in 140..200 {
            for _ in 0..9 {
                add(&mut problem, of, 0.0, 0.0, &mut rng);
            }
        }
        let (state, error) = outcome(&problem, &truth, &mut rng);
        assert!(state == State::Trusted && error < 0.05, "{scheme:?}: {state} {error}");
    }
}

#[test]
fn many_wrong_matches_on_one_spot_do_not_outvote_the_others() {
    for scheme in [Scheme::Points, Scheme::Dcl] {
        for seed in 0..4 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut problem, truth) = problem(&Setup { scheme, ..SETUP }, &mut rng);
            for _ in 0..110 {
                add(&mut problem, 170, 0.3, 0.002, &mut rng);
            }
            let (state, error) = outcome(&problem, &truth, &mut rng);
            assert!(state == State::Trusted && error < 0.05, "{scheme:?} {seed}: {state} {error}");
        }
    }
}

#[test]
fn duplicates_change_neither_pose_nor_uncertainty() {
    for scheme in [Scheme::Points, Scheme::Dcl] {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (given, truth) = problem(&Setup { scheme, ..SETUP }, &mut rng);
        let mut copied = given.clone();
        for of in (0..140).step_by(2) {
            add(&mut copied, of, 0.0, 0.0, &mut rng);
        }
        let estimate = |problem: &PoseProblem| {
            estimate_pose(problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(1))
                .expect("a pose")
        };
        let (one, two) = (estimate(&given), estimate(&copied));
        assert_eq!(one.cam_from_world, two.cam_from_world, "{scheme:?}");
        assert_eq!(one.covariance, two.covariance, "{scheme:?}");
        assert_eq!(one.inliers, two.inliers[..200], "{scheme:?}");
        for (of, copy) in (0..140).step_by(2).zip(200..) {
            assert_eq!(two.inliers[of], two.inliers[copy], "{scheme:?} {of}");
        }
        assert_eq!(two.inlier_count, two.inliers.iter().filter(|is_inlier| **is_inlier).count());
        let tracked = |problem: &PoseProblem| {
            optimize_pose(problem, &truth, &PoseOptions::default()).expect("a pose").cam_from_world
        };
        assert_eq!(tracked(&given), tracked(&copied), "{scheme:?}");
        let frame = |problem: &PoseProblem| RigFrame {
            problem: problem.clone(),
            cam_from_rig: CameraFromRig::identity(),
            rotation_sd_deg: 0.0,
            translation_sd: 0.0,
        };
        let rig = |problem: &PoseProblem| {
            let rng = &mut ChaCha8Rng::seed_from_u64(1);
            estimate_rig_pose(&[frame(problem)], &PoseOptions::default(), rng).expect("a pose")
        };
        let (one, two) = (rig(&given), rig(&copied));
        assert_eq!(one.rig_from_world, two.rig_from_world, "{scheme:?}");
        assert_eq!(two.frames[0].inliers.len(), 270, "{scheme:?}");
    }
}
