//! Camera priors from the client: they select and improve a pose; only a gravity direction that the matches confirm is a
//! reason to trust one.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::rigs::{ODOMETRY, session};
use support::{Scheme, Setup, problem};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_geometry::{CameraFromWorld, Point3, Rigid3};
use veiloc_pose::{
    Correspondences, Doubt, Gravity, PoseEstimate, PoseOptions, PoseProblem, PositionPrior, State,
    estimate_pose, estimate_rig_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// Down in the world.
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

fn estimate(problem: &PoseProblem, seed: u64) -> Option<PoseEstimate> {
    estimate_pose(problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(seed)).ok()
}

fn with_priors(
    plain: &PoseProblem,
    gravity: Option<Gravity>,
    position: Option<PositionPrior>,
) -> PoseProblem {
    let mut informed = plain.clone();
    (informed.gravity, informed.position) = (gravity, position);
    informed
}

fn is_trusted(estimate: Option<&PoseEstimate>) -> bool {
    estimate.is_some_and(|e| e.confidence.state() == State::Trusted)
}

/// Gravity as the camera would measure it, rotated by some degrees about an axis across it.
fn turned(truth: &CameraFromWorld, degrees: f64, side: f64, sd_deg: f64) -> Gravity {
    let felt = truth.rotation() * DOWN;
    let across = Unit::new_normalize(felt.cross(&Vector3::new(0.3, 0.5, -0.8)));
    let axis = Rotation3::from_axis_angle(&Unit::new_normalize(felt), side) * across;
    let turn = Rotation3::from_axis_angle(&axis, degrees.to_radians());
    Gravity { in_camera: turn * felt, in_world: DOWN, sd_deg }
}

/// The gravity of a rig is tested in every frame: right directions are confirmed, and one that a frame contradicts has no
/// influence on the pose, and is a doubt.
#[test]
fn gravity_of_a_rig_is_tested_in_every_frame() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let setup = Setup { scheme, right: 80, wrong: 60, noise: 0.5 };
        let (plain, truth) = session(&setup, 3, ODOMETRY, &mut rng);
        let found = |degrees: [f64; 3]| {
            let mut frames = plain.clone();
            for (frame, degrees) in frames.iter_mut().zip(degrees) {
                let cam = frame.cam_from_rig.compose(&truth);
                frame.problem.gravity = (!degrees.is_nan()).then(|| turned(&cam, degrees, 0.3, 0.5));
            }
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            estimate_rig_pose(&frames, &PoseOptions::default(), &mut rng).expect("a pose")
        };
        let without = found([f64::NAN; 3]);
        let right = found([0.2, 0.4, 0.0]);
        let agreement = right.confidence.gravity.expect("tested");
        assert!(agreement.log_evidence > 3.0, "{scheme:?}: {agreement:?}");
        assert!(right.confidence.rotation_sd_deg <= without.confidence.rotation_sd_deg, "{scheme:?}");
        assert_eq!(right.confidence.state(), State::Trusted, "{scheme:?}");
        let wrong = found([0.0, f64::NAN, 30.0]);
        let doubts = wrong.confidence.doubts();
        assert!(doubts.iter().any(|doubt| matches!(doubt, Doubt::Gravity { .. })), "{scheme:?}: {doubts:?}");
        let moved = wrong.rig_from_world.translation_error(&without.rig_from_world);
        assert!(moved < 0.1 * without.confidence.center_sd, "{scheme:?}: {moved}");
    }
}

#[test]
fn wrong_gravity_does_not_make_a_pose_trusted() {
    let (mut total, mut compared) = (0, 0);
    for scheme in SCHEMES {
        for (right, wrong, noise) in [(40, 30, 2.5), (25, 60, 1.0), (60, 240, 1.0)] {
            for seed in 0..2 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (plain, truth) = problem(&Setup { scheme, right, wrong, noise }, &mut rng);
                let without = estimate(&plain, seed);
                for (k, degrees) in (0_u8..).zip([5.0, 10.0, 30.0, 90.0, 180.0]) {
                    for sd_deg in [0.5, 1.0] {
                        let informed = turned(&truth, degrees, f64::from(k) + seed as f64, sd_deg);
                        let with = estimate(&with_priors(&plain, Some(informed), None), seed);
                        total += 1;
                        let what = format!("{scheme:?} {right}+{wrong} {seed}: {degrees}° ± {sd_deg}°");
                        if is_trusted(with.as_ref()) {
                            assert!(is_trusted(without.as_ref()), "{what}: the prior made it trusted");
                        }
                        let Some(without) = without.as_ref().filter(|found| is_trusted(Some(found))) else {
                            continue;
                        };
                        compared += 1;
                        let with = with.expect("a pose");
                        // As good as the pose without the prior, relative to that pose's uncertainty.
                        let off = with.cam_from_world.translation_error(&truth);
                        let own = without.cam_from_world.translation_error(&truth);
                        assert!(off < own + 4.0 * without.confidence.center_sd, "{what}: {off} after {own}");
                    }
                }
            }
        }
    }
    assert!(compared > total / 4, "{compared} of {total} compared: too few for a conclusion");
}

/// Of poses with too little evidence, a right gravity direction makes some trusted; one that is wrong by 5° none.
#[test]
fn gravity_that_the_matches_confirm_is_evidence() {
    for scheme in [Scheme::Lines, Scheme::Dcl] {
        let (mut weak, mut trusted) = (0, 0);
        for seed in 0..60 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (plain, truth) = problem(&Setup { scheme, right: 18, wrong: 12, noise: 1.0 }, &mut rng);
            let Some(without) = estimate(&plain, seed) else { continue };
            let is_weak =
                |found: &PoseEstimate| matches!(found.confidence.doubts()[..], [Doubt::WeakEvidence { .. }]);
            if !is_weak(&without) || without.cam_from_world.rotation_error_degrees(&truth) > 1.0 {
                continue;
            }
            weak += 1;
            let informed =
                |degrees| estimate(&with_priors(&plain, Some(turned(&truth, degrees, 0.0, 0.5)), None), seed);
            let right = informed(0.3);
            let gravity = right.as_ref().and_then(|found| found.confidence.gravity).expect("measured");
            if is_trusted(right.as_ref()) {
                trusted += 1;
                assert!(gravity.log_evidence > 3.0 && gravity.deviation < 3.0, "{gravity:?}");
            }
            assert!(!is_trusted(informed(5.0).as_ref()), "{scheme:?} {seed}");
        }
        assert!(weak >= 4, "{scheme:?}: {weak} weak poses are too few for a conclusion");
        assert!(
            2 * trusted >= weak,
            "{scheme:?}: {trusted} of {weak} trusted with the right gravity direction"
        );
    }
}

#[test]
fn gravity_that_the_matches_contradict_is_a_doubt_and_moves_nothing() {
    for scheme in SCHEMES {
        for degrees in [10.0, 90.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let (plain, truth) = problem(&Setup { scheme, right: 150, wrong: 50, noise: 1.0 }, &mut rng);
            let without = estimate(&plain, 3).expect("a pose");
            assert!(is_trusted(Some(&without)), "{:?}", without.confidence);
            let wrong = with_priors(&plain, Some(turned(&truth, degrees, 0.0, 0.5)), None);
            let with = estimate(&wrong, 3).expect("a pose");
            let doubts = with.confidence.doubts();
            assert!(matches!(doubts[..], [Doubt::Gravity { .. }]), "{scheme:?} {degrees}: {doubts:?}");
            let moved = with.cam_from_world.translation_error(&without.cam_from_world);
            assert!(moved < 0.1 * without.confidence.center_sd, "{scheme:?} {degrees}: {moved}");
        }
    }
}

/// A scene that exists twice, the second copy tilted: each keypoint has a match in both.
fn twice(scheme: Scheme, rng: &mut ChaCha8Rng) -> (PoseProblem, [CameraFromWorld; 2]) {
    let (mut problem, truth) = problem(&Setup { scheme, right: 150, wrong: 30, noise: 0.7 }, rng);
    let tilt: Rigid3<World, World> =
        Rigid3::new(Rotation3::from_scaled_axis(Vector3::new(0.6, 0.1, 0.0)), Vector3::new(3.0, 0.0, 1.0));
    let copied: Vec<Point3<World>> = problem.points.iter().map(|p| tilt.transform(p)).collect();
    problem.points.extend(copied);
    problem.keypoints.extend_from_within(..);
    match &mut problem.observations {
        Correspondences::Points { pixels } => pixels.extend_from_within(..),
        Correspondences::Lines { lines } => lines.extend_from_within(..),
        Correspondences::Anchored { lines, .. } => lines.extend_from_within(..),
    }
    let other = truth.compose(&tilt.inverse());
    (problem, [truth, other])
}

#[test]
fn priors_select_but_do_not_increase_trust() {
    for scheme in SCHEMES {
        // Counts for poses without and with priors: trusted, and all.
        let (mut trusted, mut chosen) = ([[0, 0]; 2], 0);
        for seed in 0..4 {
            let (plain, poses) = twice(scheme, &mut ChaCha8Rng::seed_from_u64(seed));
            let mut count = |kind: usize, found: &PoseEstimate| {
                trusted[kind][0] += usize::from(is_trusted(Some(found)));
                trusted[kind][1] += 1;
            };
            count(0, &estimate(&plain, seed).expect("a pose"));
            for pose in &poses {
                let gravity =
                    Some(Gravity { in_camera: pose.rotation() * DOWN, in_world: DOWN, sd_deg: 0.5 });
                let position = Some(PositionPrior { center: pose.center(), sd: 0.2 });
                for (gravity, position) in [(gravity, None), (None, position), (gravity, position)] {
                    let found = estimate(&with_priors(&plain, gravity, position), seed).expect("a pose");
                    chosen += usize::from(found.cam_from_world.translation_error(pose) < 0.1);
                    count(1, &found);
                }
            }
        }
        assert!(chosen >= 20, "{scheme:?}: {chosen} of 24 as the prior selects");
        let share = |[trusted, all]: [usize; 2]| trusted as f64 / all as f64;
        assert!(share(trusted[1]) <= share(trusted[0]), "{scheme:?}: {trusted:?}");
    }
}

#[test]
fn trust_ignores_camera_priors() {
    for scheme in SCHEMES {
        for seed in 0..6 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut few, truth) = problem(&Setup { scheme, right: 22, wrong: 10, noise: 4.0 }, &mut rng);
            let Some(plain) = estimate(&few, seed) else { continue };
            few.gravity = Some(turned(&truth, 0.0, 0.0, 0.1));
            few.position = Some(PositionPrior { center: truth.center(), sd: 1e-3 });
            let Some(informed) = estimate(&few, seed) else { continue };
            assert!(informed.confidence.center_sd < 2e-3, "the answer is as certain as the prior");
            assert!(
                informed.confidence.held_relative > 0.3 * plain.confidence.held_relative,
                "{scheme:?} {seed}"
            );
            assert!(informed.confidence.held_relative > informed.confidence.center_sd_relative);
        }
    }
}
