//! Out-of-map queries: configurations in which wrong matches agree must not count as evidence.

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{CAMERA, Scheme, Setup, problem};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromRig, Pencils, Pixel, PixelLine, Point3};
use veiloc_pose::{
    Correspondences, MatchViewpoint, PoseOptions, PoseProblem, RigFrame, State, estimate_pose,
    estimate_rig_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// A close-up of texture: all keypoints in a patch, matched at random to a dense corner of the map.
fn texture(scheme: Scheme, rng: &mut ChaCha8Rng) -> PoseProblem {
    let pixels: Vec<Pixel> =
        (0..600).map(|_| Pixel::new(rng.random_range(60.0..200.0), rng.random_range(180.0..320.0))).collect();
    let mut point = || {
        Point3::from_vector(
            Vector3::new(0.0, 0.0, 4.0) + Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)),
        )
    };
    let points = (0..600).map(|_| point()).collect();
    let observations = match scheme {
        Scheme::Points => Correspondences::Points { pixels },
        Scheme::Lines => Correspondences::Lines {
            lines: pixels.iter().map(|p| PixelLine::through(*p, rng.random_range(0.0..3.0))).collect(),
        },
        Scheme::Dcl => {
            let pencils = Pencils::paper(CAMERA.width, CAMERA.height);
            let line = |p: &Pixel| (pencils.anchor_of(*p), pencils.angle_of(pencils.anchor_of(*p), *p));
            let mut lines: Vec<_> = pixels.iter().map(line).collect();
            // A few on the other side, so that it is not rejected as one-sided.
            for k in 0..40 {
                lines[15 * k] =
                    line(&Pixel::new(rng.random_range(400.0..600.0), rng.random_range(10.0..470.0)));
            }
            Correspondences::Anchored { pencils, lines }
        }
    };
    PoseProblem::new(CAMERA, observations, (0..600).collect(), points)
}

#[test]
fn clustered_wrong_matches_are_not_trusted() {
    for scheme in SCHEMES {
        for seed in 0..15 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let problem = texture(scheme, &mut rng);
            if let Ok(estimate) = estimate_pose(&problem, &PoseOptions::default(), &mut rng) {
                let evidence = estimate.confidence.log_evidence;
                assert_ne!(estimate.confidence.state(), State::Trusted, "{scheme:?} {seed}: {evidence}");
                assert!(evidence < 10.0, "{scheme:?} {seed}: {evidence}");
            }
        }
    }
}

#[test]
fn pose_with_wrong_viewpoint_is_not_found() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut problem, truth) = problem(&Setup { scheme, right: 150, wrong: 150, noise: 0.5 }, &mut rng);
        let center = truth.center();
        let beside = center.coords + truth.rotation().inverse() * Vector3::new(0.3, 0.0, 0.0);
        let views = |center: Vector3<f64>| {
            let seen = MatchViewpoint { center: Point3::from_vector(center), focal_px: 525.0 };
            Some(vec![seen; 300])
        };
        problem.seen_from = views(beside);
        let near = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
        assert_eq!(near.confidence.state(), State::Trusted, "{scheme:?}");
        assert!(near.cam_from_world.translation_error(&truth) < 0.03);

        // The map saw the same points from the other side.
        let ahead = truth.rotation().inverse() * Vector3::new(0.0, 0.0, 8.0);
        problem.seen_from = views(center.coords + ahead);
        if let Ok(far) = estimate_pose(&problem, &PoseOptions::default(), &mut rng) {
            assert_eq!(far.confidence.state(), State::NotFound, "{scheme:?} {}", far.confidence.log_evidence);
        }
    }
}

#[test]
fn session_of_clustered_wrong_matches_is_not_trusted() {
    for scheme in SCHEMES {
        for seed in 0..3 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let frames: Vec<RigFrame> = (0..4)
                .map(|k| RigFrame {
                    problem: texture(scheme, &mut rng),
                    cam_from_rig: CameraFromRig::identity(),
                    rotation_sd_deg: if k == 0 { 0.0 } else { 0.1 },
                    translation_sd: if k == 0 { 0.0 } else { 0.01 },
                })
                .collect();
            if let Ok(estimate) = estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng) {
                let evidence = estimate.confidence.log_evidence;
                assert_ne!(estimate.confidence.state(), State::Trusted, "{scheme:?} {seed}: {evidence}");
            }
        }
    }
}

#[test]
fn duplicates_of_a_clustered_frame_are_not_trusted() {
    for scheme in SCHEMES {
        for seed in 0..3 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let problem = texture(scheme, &mut rng);
            let frame = RigFrame {
                problem,
                cam_from_rig: CameraFromRig::identity(),
                rotation_sd_deg: 0.1,
                translation_sd: 0.01,
            };
            let mut frames = vec![frame; 8];
            (frames[0].rotation_sd_deg, frames[0].translation_sd) = (0.0, 0.0);
            if let Ok(estimate) = estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng) {
                let evidence = estimate.confidence.log_evidence;
                assert_ne!(estimate.confidence.state(), State::Trusted, "{scheme:?} {seed}: {evidence}");
            }
        }
    }
}

#[test]
fn duplicates_of_a_frame_count_once() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (problem, _) = problem(&Setup { scheme, right: 25, wrong: 25, noise: 1.0 }, &mut rng);
        let cam_from_rig = CameraFromRig::identity();
        let frame = RigFrame { problem, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 };
        let of = |copies: usize| {
            let frames = vec![frame.clone(); copies];
            let rng = &mut ChaCha8Rng::seed_from_u64(1);
            estimate_rig_pose(&frames, &PoseOptions::default(), rng).expect("a pose").confidence
        };
        let (one, eight) = (of(1), of(8));
        assert!(eight.log_evidence <= one.log_evidence, "{scheme:?}: {one:?} {eight:?}");
        assert!(eight.log_evidence > one.log_evidence - 5.0, "{scheme:?}: {one:?} {eight:?}");
        assert!(eight.center_sd > 0.6 * one.center_sd, "{scheme:?}: {one:?} {eight:?}");
    }
}
