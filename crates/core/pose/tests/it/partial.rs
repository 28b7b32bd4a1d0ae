//! Queries whose lines all belong to one anchor: the pose is determined up to one parameter, and that one is reported
//! as free.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{CAMERA, Scheme, Setup, problem};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld};
use veiloc_pose::{Correspondences, PoseOptions, PoseProblem, State, estimate_pose};

/// The lines of the first anchor, and a number of lines of the second.
fn one_sided(rng: &mut ChaCha8Rng, others: usize) -> (PoseProblem, CameraFromWorld) {
    let (full, truth) = problem(&Setup { scheme: Scheme::Dcl, right: 200, wrong: 200, noise: 0.5 }, rng);
    let Correspondences::Anchored { pencils, lines } = full.observations else { unreachable!() };
    let mut left = others;
    let mut keep = |i: &usize| {
        let second = lines[*i].0 == Anchor::SECOND;
        if second && left > 0 {
            left -= 1;
            return true;
        }
        !second
    };
    let keep: Vec<usize> = (0..lines.len()).filter(|i| keep(i)).collect();
    let observations = Correspondences::Anchored { pencils, lines: keep.iter().map(|&i| lines[i]).collect() };
    let points = keep.iter().map(|&i| full.points[i]).collect();
    (PoseProblem::new(CAMERA, observations, (0..keep.len()).collect(), points), truth)
}

#[test]
fn one_anchor_gives_a_pose_with_free_direction() {
    for others in [0, 2] {
        for seed in 0..10 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, truth) = one_sided(&mut rng, others);
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a partial pose");
            assert_eq!(found.confidence.state(), State::Doubtful, "{others} {seed}");
            assert!(found.cam_from_world.rotation_error_degrees(&truth) < 0.5, "{others} {seed}");
            let free = Vector3::from(found.free_direction.expect("a free direction"));
            let Correspondences::Anchored { pencils, .. } = &problem.observations else { unreachable!() };
            let at = pencils.position(Anchor::FIRST).expect("at the edge");
            let ray = CAMERA.unproject(at).homogeneous().normalize();
            assert!((truth.rotation() * free).dot(&ray).abs() > 0.999, "{others} {seed}");
            let off = found.cam_from_world.center().coords - truth.center().coords;
            assert!((off - free * free.dot(&off)).norm() < 0.05, "{others} {seed}: {off}");
            // The ray has no component across the image: that direction is known, the other two are not.
            let sd = |k: usize| found.covariance[k][k].sqrt();
            assert!(sd(3) < 0.05 && sd(4).is_infinite() && sd(5).is_infinite(), "{others} {seed}");
            assert!(found.confidence.center_sd.is_infinite());
            // The principal point of the camera may be 1.5 % of the width off, which is a degree.
            assert!((0..3).all(|k| sd(k) < 0.03), "{:?}", [0, 1, 2].map(sd));
        }
    }
}

#[test]
fn few_lines_of_the_second_anchor_fix_the_depth() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (problem, truth) = one_sided(&mut rng, 60);
    let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
    assert_eq!((found.confidence.state(), found.free_direction), (State::Trusted, None));
    assert!(found.cam_from_world.translation_error(&truth) < 0.1);
}
