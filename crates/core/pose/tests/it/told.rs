//! What the other side says of the camera beside its matches: it may choose and improve a pose, it never makes one trusted.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, problem};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_geometry::{CameraFromWorld, Point3, Rigid3};
use veiloc_pose::{
    Correspondences, Gravity, PoseEstimate, PoseOptions, PoseProblem, PositionPrior, State, estimate_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// Down in the world, whatever the camera does.
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

fn estimate(problem: &PoseProblem, seed: u64) -> Option<PoseEstimate> {
    estimate_pose(problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(seed)).ok()
}

fn with_told(plain: &PoseProblem, gravity: Option<Gravity>, position: Option<PositionPrior>) -> PoseProblem {
    let mut told = plain.clone();
    (told.gravity, told.position) = (gravity, position);
    told
}

fn is_trusted(estimate: Option<&PoseEstimate>) -> bool {
    estimate.is_some_and(|e| e.confidence.state() == State::Trusted)
}

/// Gravity as the camera would feel it, turned by some degrees about an axis across it.
fn turned(truth: &CameraFromWorld, degrees: f64, side: f64, sd_deg: f64) -> Gravity {
    let felt = truth.rotation() * DOWN;
    let across = Unit::new_normalize(felt.cross(&Vector3::new(0.3, 0.5, -0.8)));
    let axis = Rotation3::from_axis_angle(&Unit::new_normalize(felt), side) * across;
    let turn = Rotation3::from_axis_angle(&axis, degrees.to_radians());
    Gravity { in_camera: turn * felt, in_world: DOWN, sd_deg }
}

#[test]
fn a_wrong_direction_of_gravity_is_not_trusted_into_a_pose() {
    let (mut asked, mut kept) = (0, 0);
    for scheme in SCHEMES {
        for (right, wrong, noise) in [(40, 30, 2.5), (25, 60, 1.0), (60, 240, 1.0)] {
            for seed in 0..4 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (plain, truth) = problem(&Setup { scheme, right, wrong, noise }, &mut rng);
                let without = estimate(&plain, seed);
                for (k, degrees) in (0_u8..).zip([4.0, 10.0, 30.0, 90.0, 180.0]) {
                    for sd_deg in [0.5, 2.0] {
                        let told = turned(&truth, degrees, f64::from(k) + seed as f64, sd_deg);
                        let with = estimate(&with_told(&plain, Some(told), None), seed);
                        asked += 1;
                        if !is_trusted(with.as_ref()) {
                            continue;
                        }
                        kept += 1;
                        let what = format!("{scheme:?} {right}+{wrong} {seed}: {degrees}° ± {sd_deg}°");
                        assert!(is_trusted(without.as_ref()), "{what}: trusted by what was said");
                        let (with, without) = (with.expect("a pose"), without.as_ref().expect("a pose"));
                        // As good as the pose without it, by that pose's own measure.
                        let off = with.cam_from_world.translation_error(&truth);
                        let own = without.cam_from_world.translation_error(&truth);
                        assert!(off < own + 4.0 * without.confidence.center_sd, "{what}: {off} after {own}");
                    }
                }
            }
        }
    }
    assert!(kept > asked / 4, "{kept} of {asked} trusted: most of these say nothing");
}

/// A place that stands there twice, the second time tilted: each keypoint has a match in both.
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
fn what_is_told_chooses_between_two_poses_and_makes_neither_sure() {
    for scheme in SCHEMES {
        // Of poses that nothing is told of, and of poses that are told: trusted, and all.
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
                    let found = estimate(&with_told(&plain, gravity, position), seed).expect("a pose");
                    chosen += usize::from(found.cam_from_world.translation_error(pose) < 0.1);
                    count(1, &found);
                }
            }
        }
        assert!(chosen >= 20, "{scheme:?}: {chosen} of 24 as told");
        let share = |[trusted, all]: [usize; 2]| trusted as f64 / all as f64;
        assert!(share(trusted[1]) <= share(trusted[0]), "{scheme:?}: {trusted:?}");
    }
}

#[test]
fn what_the_matches_do_not_hold_is_not_held_by_what_is_told() {
    for scheme in SCHEMES {
        for seed in 0..6 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut few, truth) = problem(&Setup { scheme, right: 22, wrong: 10, noise: 4.0 }, &mut rng);
            let Some(plain) = estimate(&few, seed) else { continue };
            few.gravity = Some(turned(&truth, 0.0, 0.0, 0.1));
            few.position = Some(PositionPrior { center: truth.center(), sd: 1e-3 });
            let Some(told) = estimate(&few, seed) else { continue };
            assert!(told.confidence.center_sd < 2e-3, "the answer is as sure as what was told");
            assert!(
                told.confidence.held_relative > 0.3 * plain.confidence.held_relative,
                "{scheme:?} {seed}"
            );
            assert!(told.confidence.held_relative > told.confidence.center_sd_relative);
        }
    }
}
