//! `estimate_rig_pose` on synthetic sessions: several frames are better than one, poor and wrong ones do no harm, and
//! the covariance covers the error.

use super::support;
use super::support::rigs;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rigs::{ODOMETRY, measured, rig, session};
use support::{Scheme, Setup, problem, seen_from};
use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use veiloc_geometry::{Anchor, CameraFromRig, RigFromWorld, Rigid3};
use veiloc_pose::{
    Correspondences, PoseError, PoseOptions, PoseProblem, RigEstimate, RigFrame, ScoreKind, State,
    estimate_pose, estimate_rig_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// Odometry that is less accurate than the frames.
const LOOSE: [f64; 2] = [0.2, 0.01];

fn estimate(frames: &[RigFrame], seed: u64) -> Result<RigEstimate, PoseError> {
    estimate_rig_pose(frames, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(seed))
}

/// Only the first `count` correspondences.
fn first(problem: &PoseProblem, count: usize) -> PoseProblem {
    let observations = match &problem.observations {
        Correspondences::Points { pixels } => Correspondences::Points { pixels: pixels[..count].to_vec() },
        Correspondences::Lines { lines } => Correspondences::Lines { lines: lines[..count].to_vec() },
        Correspondences::Anchored { pencils, lines } => {
            Correspondences::Anchored { pencils: pencils.clone(), lines: lines[..count].to_vec() }
        }
    };
    let (keypoints, points) = (problem.keypoints[..count].to_vec(), problem.points[..count].to_vec());
    PoseProblem::new(problem.camera, observations, keypoints, points)
}

#[test]
fn single_frame_rig_equals_estimate_pose() {
    for scheme in SCHEMES {
        for seed in 0..10 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, _) = problem(&Setup { scheme, right: 120, wrong: 180, noise: 0.5 }, &mut rng);
            let options = PoseOptions::default();
            let alone =
                estimate_pose(&problem, &options, &mut ChaCha8Rng::seed_from_u64(seed)).expect("a pose");
            let cam_from_rig = CameraFromRig::identity();
            let frame = RigFrame { problem, cam_from_rig, rotation_sd_deg: 0.0, translation_sd: 0.0 };
            let rig = estimate(&[frame], seed).expect("a pose");
            assert!(
                rig.frames[0].cam_from_world.translation_error(&alone.cam_from_world) < 1e-4,
                "{scheme:?} {seed}"
            );
            assert_eq!(rig.hypotheses, alone.hypotheses, "{scheme:?} {seed}");
            assert_eq!(rig.frames[0].inliers, alone.inliers);
            assert!((rig.frames[0].noise_px.expect("inliers") / alone.noise_px - 1.0).abs() < 0.01);
            for k in 0..6 {
                let [rig, alone] = [rig.covariance[k][k], alone.covariance[k][k]];
                assert!((rig / alone - 1.0).abs() < 0.02, "{scheme:?} {seed} {k}: {rig} {alone}");
            }
            assert!((rig.confidence.log_evidence / alone.confidence.log_evidence - 1.0).abs() < 0.01);
            assert_eq!(rig.confidence.state(), alone.confidence.state());
        }
    }
}

#[test]
fn several_frames_reduce_the_error_within_the_covariance() {
    // The squared Mahalanobis distance of the true pose follows χ² of six degrees of freedom.
    const QUANTILES: [(f64, f64); 3] = [(0.5, 5.348), (0.9, 10.645), (0.99, 16.812)];
    const SESSIONS: u64 = 80;
    for (scheme, odometry) in SCHEMES.into_iter().flat_map(|s| [(s, ODOMETRY), (s, LOOSE)]) {
        let setup = Setup { scheme, right: 100, wrong: 100, noise: 1.0 };
        let (mut squared, mut distances) = ([0.0; 2], Vec::new());
        for seed in 0..SESSIONS {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (frames, truth) = session(&setup, 4, odometry, &mut rng);
            let alone = estimate(&frames[..1], seed).expect("a pose");
            let all = estimate(&frames, seed).expect("a pose");
            for (sum, found) in squared.iter_mut().zip([&alone, &all]) {
                *sum += found.rig_from_world.translation_error(&truth).powi(2);
            }
            let step = Vector6::from(truth.step_to(&all.rig_from_world));
            // The cameras of this test are exact.
            let noise = all.noise_covariance();
            let covariance = Matrix6::from_fn(|i, j| noise[i][j]);
            distances.push(step.dot(&(covariance.try_inverse().expect("invertible") * step)));
            assert_eq!(all.confidence.state(), State::Trusted, "{scheme:?} {seed}: {:?}", all.confidence);
        }
        let [alone, all] = squared.map(|s| (s / SESSIONS as f64).sqrt());
        let most = if odometry == ODOMETRY { 0.8 } else { 1.02 };
        assert!(all < most * alone, "{scheme:?} {odometry:?}: {all} with four frames, {alone} with one");
        for (share, quantile) in QUANTILES {
            let inside = distances.iter().filter(|d| **d < quantile).count() as f64 / SESSIONS as f64;
            let slack = 3.0 * (share * (1.0 - share) / SESSIONS as f64).sqrt() + 0.02;
            assert!((inside - share).abs() < slack, "{scheme:?} {odometry:?}: {inside} for {share}");
        }
    }
}

#[test]
fn several_frames_increase_recall() {
    for (scheme, right, wrong) in [(Scheme::Points, 8, 150), (Scheme::Lines, 25, 110), (Scheme::Dcl, 25, 150)]
    {
        let (mut alone, mut all) = (0, 0);
        for seed in 0..10 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let setup = Setup { scheme, right, wrong, noise: 1.0 };
            let (frames, truth) = session(&setup, 4, ODOMETRY, &mut rng);
            let near = |found: Result<RigEstimate, PoseError>| {
                found.is_ok_and(|f| f.rig_from_world.translation_error(&truth) < 0.1)
            };
            alone += usize::from(near(estimate(&frames[..1], seed)));
            all += usize::from(near(estimate(&frames, seed)));
        }
        assert!(all >= 9 && alone <= 7, "{scheme:?}: {alone} alone, {all} together, of 10");
    }
}

/// Root mean squared error of the rig's position over sessions modified by `change`; all must be trusted.
fn error(scheme: Scheme, sessions: u64, change: impl Fn(&mut Vec<RigFrame>, &mut ChaCha8Rng)) -> f64 {
    let setup = Setup { scheme, right: 100, wrong: 100, noise: 1.0 };
    let squared = (0..sessions).map(|seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
        let (mut frames, truth) = session(&setup, 3, ODOMETRY, &mut rng);
        change(&mut frames, &mut rng);
        let found = estimate(&frames, seed).expect("a pose");
        assert_eq!(found.confidence.state(), State::Trusted, "{scheme:?} {seed}: {:?}", found.confidence);
        assert_eq!(found.frames.len(), frames.len());
        for (estimate, given) in found.frames.iter().zip(&frames) {
            assert_eq!(estimate.inliers.len(), given.problem.points.len());
            assert!(estimate.cam_from_world.is_finite());
        }
        found.rig_from_world.translation_error(&truth).powi(2)
    });
    (squared.sum::<f64>() / sessions as f64).sqrt()
}

/// A frame of another scene: its matches agree on a pose that contradicts its odometry.
fn out_of_place_frame(scheme: Scheme, rng: &mut ChaCha8Rng) -> RigFrame {
    let (problem, _) = problem(&Setup { scheme, right: 200, wrong: 50, noise: 0.5 }, rng);
    measured(problem, &CameraFromRig::identity(), ODOMETRY, rng)
}

#[test]
fn poor_or_wrong_frames_do_not_increase_the_error() {
    for scheme in SCHEMES {
        let without = error(scheme, 20, |_, _| {});
        let check = |what: &str, most: f64, change: &dyn Fn(&mut Vec<RigFrame>, &mut ChaCha8Rng)| {
            let with = error(scheme, 20, change);
            assert!(with < most * without, "{scheme:?} {what}: {with} with, {without} without");
        };
        check("empty", 1.01, &|frames, _| {
            let mut empty = frames[1].clone();
            empty.problem = first(&empty.problem, 0);
            frames.insert(1, empty);
        });
        check("few", 1.1, &|frames, _| {
            let mut few = frames[1].clone();
            few.problem = first(&few.problem, 2);
            frames.push(few);
        });
        // A third of the frames, with more matches than any other.
        check("out of place", 1.1, &|frames, rng| frames.insert(0, out_of_place_frame(scheme, rng)));
        check("slipped", 1.6, &|frames, _| {
            let slip = RigFromWorld::identity().perturbed(&[0.0, 0.1, 0.0, 0.3, 0.3, 0.0]);
            let slipped = Rigid3::new(
                frames[1].cam_from_rig.rotation() * slip.rotation(),
                frames[1].cam_from_rig.translation() + slip.translation(),
            );
            frames[1].cam_from_rig = slipped;
        });
        check("nothing right", 1.1, &|frames, rng| {
            let setup = Setup { scheme, right: 0, wrong: 300, noise: 1.0 };
            let problem = seen_from(&Rigid3::identity(), &setup, rng);
            frames.push(measured(problem, &CameraFromRig::identity(), ODOMETRY, rng));
        });
    }
}

#[test]
fn frames_without_own_pose_reduce_the_error() {
    for scheme in [Scheme::Lines, Scheme::Dcl] {
        let mean = |help: bool| {
            let mut squared = 0.0;
            for seed in 0..30 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (truth, on_rig) = rig(6, &mut rng);
                let mut frames: Vec<RigFrame> = Vec::new();
                for (i, on_rig) in on_rig.iter().enumerate() {
                    let right = if i == 0 { 30 } else { 60 };
                    let setup = Setup { scheme, right, wrong: 20, noise: 1.0 };
                    let mut problem = seen_from(&on_rig.compose(&truth), &setup, &mut rng);
                    if i > 0 {
                        problem = poor(&problem);
                    }
                    frames.push(measured(
                        problem,
                        on_rig,
                        if i == 0 { [0.0; 2] } else { ODOMETRY },
                        &mut rng,
                    ));
                }
                assert!(frames[1..].iter().all(|f| {
                    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
                    let alone = estimate_pose(&f.problem, &PoseOptions::default(), rng);
                    !alone.is_ok_and(|e| e.confidence.is_trusted())
                }));
                let found = estimate(if help { &frames } else { &frames[..1] }, seed).expect("a pose");
                squared += found.rig_from_world.translation_error(&truth).powi(2);
            }
            (squared / 30.0_f64).sqrt()
        };
        let (with, without) = (mean(true), mean(false));
        assert!(with < 0.8 * without, "{scheme:?}: {with} with, {without} without");
    }
}

/// Lines too few for a sample, or all of one anchor.
fn poor(problem: &PoseProblem) -> PoseProblem {
    let Correspondences::Anchored { pencils, lines } = &problem.observations else {
        return first(problem, 5);
    };
    let chosen: Vec<usize> = (0..lines.len()).filter(|&i| lines[i].0 == Anchor::FIRST).collect();
    let lines = chosen.iter().map(|&i| lines[i]).collect();
    let points = chosen.iter().map(|&i| problem.points[i]).collect();
    let observations = Correspondences::Anchored { pencils: pencils.clone(), lines };
    PoseProblem::new(problem.camera, observations, chosen, points)
}

#[test]
fn equal_seeds_give_equal_rigs() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let setup = Setup { scheme, right: 60, wrong: 200, noise: 1.0 };
        let (frames, _) = session(&setup, 3, ODOMETRY, &mut rng);
        assert_eq!(estimate(&frames, 5), estimate(&frames, 5));
    }
}

#[test]
fn session_without_fixed_frame_is_less_certain() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let setup = Setup { scheme: Scheme::Points, right: 200, wrong: 50, noise: 0.3 };
    let (mut frames, _) = session(&setup, 4, ODOMETRY, &mut rng);
    let fixed = estimate(&frames, 1).expect("a pose");
    (frames[0].rotation_sd_deg, frames[0].translation_sd) = (1.0, 0.05);
    for frame in &mut frames[1..] {
        (frame.rotation_sd_deg, frame.translation_sd) = (1.0, 0.05);
    }
    let loose = estimate(&frames, 1).expect("a pose");
    // Four independent measurements of 5 cm.
    assert!(fixed.confidence.center_sd < 0.01, "{:?}", fixed.confidence);
    assert!((loose.confidence.center_sd / 0.025 - 1.0).abs() < 0.15, "{:?}", loose.confidence);
    assert!(loose.frames.iter().all(|f| f.odometry_deviation > 0.0 && f.odometry_deviation < 4.0));
}

#[test]
fn invalid_rigs_are_rejected() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let setup = Setup { scheme: Scheme::Dcl, right: 60, wrong: 20, noise: 1.0 };
    let (frames, _) = session(&setup, 2, ODOMETRY, &mut rng);
    assert_eq!(estimate(&[], 1), Err(PoseError::NoFrames));
    let with = |change: &dyn Fn(&mut RigFrame)| {
        let mut frames = frames.clone();
        change(&mut frames[1]);
        estimate(&frames, 1).expect_err("refused").to_string()
    };
    let messages = [
        with(&|f| f.rotation_sd_deg = f64::NAN),
        with(&|f| f.translation_sd = -1.0),
        with(&|f| f.translation_sd = f64::INFINITY),
        with(&|f| f.cam_from_rig = Rigid3::new(Rotation3::identity(), Vector3::repeat(f64::NAN))),
        with(&|f| f.problem.points[0] = veiloc_geometry::Point3::new(f64::NAN, 0.0, 0.0)),
        with(&|f| f.problem.keypoints.truncate(3)),
    ];
    for message in messages {
        assert!(message.starts_with("frame 1: "), "{message}");
    }
    let mut options = PoseOptions::default();
    options.score = Some(ScoreKind::Msac);
    let refused = estimate_rig_pose(&frames, &options, &mut rng);
    assert_eq!(refused, Err(PoseError::ScoreOfRig));
    let few: Vec<RigFrame> =
        frames.iter().map(|f| RigFrame { problem: first(&f.problem, 4), ..f.clone() }).collect();
    assert_eq!(estimate(&few, 1), Err(PoseError::NoFrameAlone { frames: 2 }));
}
