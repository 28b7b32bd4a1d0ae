//! `estimate_rig_pose` with an open or wrong focal length: it is estimated or doubted, never trusted and wrong.

use super::support;
use super::support::rigs;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rigs::{ODOMETRY, session};
use support::{Scheme, Setup, bend, problem};
use veiloc_geometry::{CameraFromRig, RigFromWorld};
use veiloc_pose::likelihood::MapCameras;
use veiloc_pose::{FocalPrior, PoseOptions, RigEstimate, RigFrame, State, estimate_pose, estimate_rig_pose};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// Sessions whose frames have a focal length that is a multiple of the true one.
fn zoomed(
    setup: &Setup,
    frames: usize,
    factor: f64,
    focal: FocalPrior,
    seed: u64,
) -> (Vec<RigFrame>, RigFromWorld) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut frames, truth) = session(setup, frames, ODOMETRY, &mut rng);
    for frame in &mut frames {
        frame.problem.camera.focal = frame.problem.camera.focal.map(|f| f * factor);
        frame.problem.focal = focal;
    }
    (frames, truth)
}

fn estimate(frames: &[RigFrame], seed: u64) -> RigEstimate {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    estimate_rig_pose(frames, &PoseOptions::default(), rng).expect("a pose")
}

#[test]
fn wrong_focal_length_is_estimated_and_right_one_unchanged() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 100, wrong: 100, noise: 0.7 };
        for (factor, focal) in [
            (1.03, FocalPrior::Calibrated),
            (0.9, FocalPrior::Calibrated),
            (1.1, FocalPrior::Calibrated),
            (1.3, FocalPrior::Calibrated),
            (0.7, FocalPrior::Calibrated),
            (1.03, FocalPrior::Exif),
            (0.9, FocalPrior::Exif),
            (1.1, FocalPrior::Unknown),
            (0.7, FocalPrior::Unknown),
            (1.3, FocalPrior::Unknown),
        ] {
            let mut estimated = 0;
            for seed in 0..5 {
                let (frames, truth) = zoomed(&setup, 3, factor, focal, seed);
                let found = estimate(&frames, seed);
                let scale = found.frames[0].focal_scale;
                let error = found.rig_from_world.translation_error(&truth);
                let what = format!("{scheme:?} {factor} {focal:?} {seed}: {scale}, off by {error}");
                assert!(found.frames.iter().all(|frame| frame.focal_scale == scale), "{what}");
                if found.confidence.state() != State::Trusted {
                    assert!(factor == 1.03 && focal == FocalPrior::Calibrated, "{what}");
                    assert!(found.confidence.other_focal.is_some(), "{what}: {:?}", found.confidence);
                    continue;
                }
                estimated += 1;
                assert!((scale * factor - 1.0).abs() < 0.01, "{what}");
                assert!(error < 0.05 && error < 5.0 * found.confidence.center_sd, "{what}");
            }
            assert!(estimated > 0 || factor == 1.03, "{scheme:?} {factor} {focal:?}");
        }
        for seed in 0..10 {
            let (frames, _) = zoomed(&setup, 3, 1.0, FocalPrior::Calibrated, seed);
            let found = estimate(&frames, seed);
            assert!(found.frames.iter().all(|frame| frame.focal_scale == 1.0), "{scheme:?} {seed}");
            assert_eq!(found.confidence.other_focal, None, "{scheme:?} {seed}");
        }
    }
}

#[test]
fn several_frames_estimate_the_focal_length_better() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 60, wrong: 60, noise: 1.0 };
        let spread = |frames: usize| {
            let squared = (0..20).map(|seed| {
                let (session, _) = zoomed(&setup, 6, 1.1, FocalPrior::Unknown, seed);
                (estimate(&session[..frames], seed).frames[0].focal_scale * 1.1).ln().powi(2)
            });
            (squared.sum::<f64>() / 20.0).sqrt()
        };
        let (one, six) = (spread(1), spread(6));
        assert!(six < 0.75 * one, "{scheme:?}: {six} with six frames, {one} with one");
    }
}

/// All frames of a session have the same wrong principal point, so that more frames do not make the pose better.
#[test]
fn wrong_principal_point_is_covered_or_doubted() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 100, wrong: 100, noise: 0.7 };
        let (mut trusted, mut doubted) = (0, 0);
        for shift in [[0.0; 2], [6.0, -4.0], [40.0, 0.0], [-30.0, 60.0]] {
            for seed in 0..5 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (mut frames, truth) = session(&setup, 3, ODOMETRY, &mut rng);
                for frame in &mut frames {
                    let camera = &mut frame.problem.camera;
                    camera.principal = [0, 1].map(|k| camera.principal[k] + shift[k]);
                }
                let found = estimate(&frames, seed);
                let error = found.rig_from_world.translation_error(&truth);
                let turn = found.rig_from_world.rotation_error_degrees(&truth);
                let what = format!("{scheme:?} {shift:?} {seed}: {error} {turn} {:?}", found.confidence);
                if found.confidence.state() == State::Trusted {
                    trusted += usize::from(shift == [0.0; 2]);
                    assert!(error < 4.0 * found.confidence.center_sd, "{what}");
                    assert!(turn < 4.0 * found.confidence.rotation_sd_deg, "{what}");
                } else {
                    doubted += usize::from(found.confidence.is_camera_contradicted);
                    assert!(shift[0].abs() > 10.0, "{what}");
                }
            }
        }
        assert!(trusted == 5 && doubted > 3, "{scheme:?}: {trusted} {doubted}");
    }
}

/// Distortion that the images of the map lack, too, resembles another focal length; it is not estimated then.
#[test]
fn distortion_of_the_map_is_no_other_focal_length() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 40, wrong: 40, noise: 0.7 };
        let estimated = |map_cameras, frames| {
            let of_seed = |seed: &u64| {
                let mut rng = ChaCha8Rng::seed_from_u64(*seed);
                let (mut frames, truth) = session(&setup, frames, ODOMETRY, &mut rng);
                for frame in &mut frames {
                    bend(&mut frame.problem, &frame.cam_from_rig.compose(&truth), -0.15);
                    frame.problem.map_cameras = map_cameras;
                }
                estimate(&frames, *seed).frames.iter().any(|frame| frame.focal_scale != 1.0)
            };
            (0..10).filter(of_seed).count()
        };
        let mut distorted = MapCameras::UNMEASURED;
        distorted.sd[5] = 0.15;
        for frames in [1, 3] {
            let counts = (estimated(MapCameras::UNMEASURED, frames), estimated(distorted, frames));
            println!("{scheme:?} {frames} {counts:?}");
            // A single frame that nothing else speaks against is not searched with other focal lengths.
            let least = if frames == 1 { 1 } else { 3 };
            assert!(counts.0 >= least && counts.1 == 0, "{scheme:?}, {frames} frames: {counts:?}");
        }
    }
}

#[test]
fn single_frame_rig_has_the_same_focal_length() {
    for scheme in SCHEMES {
        for (factor, focal) in [(1.1, FocalPrior::Calibrated), (0.8, FocalPrior::Unknown)] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let (mut problem, _) = problem(&Setup { scheme, right: 150, wrong: 100, noise: 0.5 }, &mut rng);
            problem.camera.focal = problem.camera.focal.map(|f| f * factor);
            problem.focal = focal;
            let rng = &mut ChaCha8Rng::seed_from_u64(7);
            let alone = estimate_pose(&problem, &PoseOptions::default(), rng).expect("a pose");
            let cam_from_rig = CameraFromRig::identity();
            let frame = RigFrame { problem, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 };
            let rig = estimate(&[frame], 7);
            let what = format!("{scheme:?} {factor}");
            assert!((rig.frames[0].focal_scale / alone.focal_scale - 1.0).abs() < 1e-3, "{what}");
            assert_eq!(rig.confidence.state(), alone.confidence.state(), "{what}");
            for k in 0..6 {
                assert!((rig.covariance[k][k] / alone.covariance[k][k] - 1.0).abs() < 0.05, "{what} {k}");
            }
        }
    }
}

/// Two cameras on one rig, one of them with a wrong focal length: the other's frames are not changed.
#[test]
fn focal_lengths_are_estimated_per_camera() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 120, wrong: 60, noise: 0.7 };
        for seed in 0..4 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut frames, truth) = session(&setup, 4, ODOMETRY, &mut rng);
            for frame in &mut frames[2..] {
                frame.problem.camera.focal = frame.problem.camera.focal.map(|f| f * 1.15);
            }
            let found = estimate(&frames, seed);
            let scales: Vec<f64> = found.frames.iter().map(|frame| frame.focal_scale).collect();
            assert_eq!(scales[..2], [1.0; 2], "{scheme:?} {seed}");
            assert!((scales[2] * 1.15 - 1.0).abs() < 0.01 && scales[2] == scales[3], "{scheme:?} {scales:?}");
            assert!(found.rig_from_world.translation_error(&truth) < 0.02, "{scheme:?} {seed}");
        }
    }
}
