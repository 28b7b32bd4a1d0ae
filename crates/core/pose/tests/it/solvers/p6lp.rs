//! `p6lp` on random problems: the true pose is found, what is returned is valid, degenerate samples give nothing.
#![expect(clippy::print_stderr, reason = "prints the measured shares")]

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld, PlaneLine, Point3};
use veiloc_pose::solvers::{ArrayVec, p6lp};

type Sample = ([PlaneLine; 6], [Point3<World>; 6]);

/// Solves many samples of one kind; returns the share in which the true pose was found, after checking every pose.
fn found_share(
    name: &str,
    seed: u64,
    count: usize,
    mut sample: impl FnMut(&mut ChaCha8Rng, &CameraFromWorld) -> Sample,
) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut found, mut returned) = (0, 0);
    for _ in 0..count {
        let truth = random_pose(&mut rng);
        let (lines, points) = sample(&mut rng, &truth);
        let mut poses = ArrayVec::new();
        let appended = p6lp(&lines, &points, &mut poses);
        assert_eq!(appended, poses.len());
        for pose in &poses {
            let r = pose.rotation().matrix();
            assert!((r * r.transpose()).is_identity(1e-9));
            for (line, point) in lines.iter().zip(&points) {
                let p = pose.transform(point);
                assert!(p.depth() > 0.0);
                assert!(line.normal().dot(&p.coords).abs() <= 1e-6 * (1.0 + p.coords.norm()), "{name}");
            }
        }
        returned += poses.len();
        found += usize::from(poses.iter().any(|p| difference(p, &truth) < 1e-5));
    }
    let share = found as f64 / count as f64;
    eprintln!("{name}: found {:.3} %, {:.2} poses a sample", 100.0 * share, returned as f64 / count as f64);
    share
}

fn anchored(split: usize) -> impl FnMut(&mut ChaCha8Rng, &CameraFromWorld) -> Sample {
    move |rng, truth| {
        let pairs: [_; 6] = std::array::from_fn(|i| {
            let anchor = if i < split { Anchor::FIRST } else { Anchor::SECOND };
            random_match_on(rng, truth, anchor)
        });
        (pairs.map(|(pixel, _)| dcl_line(pixel)), pairs.map(|(_, point)| point))
    }
}

#[test]
fn the_true_pose_is_found_for_random_lines() {
    let share = found_share("random lines", 1, 20_000, |rng, truth| {
        let pairs: [_; 6] = std::array::from_fn(|_| random_match(rng, truth));
        (pairs.map(|(pixel, _)| random_line(rng, pixel)), pairs.map(|(_, point)| point))
    });
    assert!(share >= 0.999, "{share}");
}

#[test]
fn true_pose_is_found_for_all_anchor_splits() {
    for split in 1..=5 {
        let share =
            found_share(&format!("dcl {split}+{}", 6 - split), 10 + split as u64, 10_000, anchored(split));
        assert!(share >= 0.999, "{split}: {share}");
    }
}

#[test]
fn axis_aligned_poses_are_found() {
    // Identity, quarter and half turns about the axes: where a Cayley chart or a bad pre-rotation would fail.
    use veiloc_geometry::nalgebra::Rotation3;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut found, mut total) = (0, 0);
    for _ in 0..200 {
        for quarter in 0..4 {
            for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
                let r = Rotation3::from_axis_angle(&axis, f64::from(quarter) * std::f64::consts::FRAC_PI_2);
                let truth = CameraFromWorld::new(r, Vector3::new(0.0, 0.0, rng.random_range(0.0..3.0)));
                let pairs: [_; 6] = std::array::from_fn(|_| random_match(&mut rng, &truth));
                let lines = pairs.map(|(pixel, _)| random_line(&mut rng, pixel));
                let mut poses = ArrayVec::new();
                p6lp(&lines, &pairs.map(|(_, point)| point), &mut poses);
                found += usize::from(poses.iter().any(|p| difference(p, &truth) < 1e-5));
                total += 1;
            }
        }
    }
    assert!(found * 1000 >= total * 998, "{found} of {total}");
}

#[test]
fn near_degenerate_samples_still_give_valid_poses() {
    // Planar scenes, far and narrow scenes, points close together: the pose may be inaccurate, but the equations must
    // hold.
    let planar = found_share("planar scene", 21, 10_000, |rng, truth| {
        let pairs: [_; 6] = std::array::from_fn(|_| {
            let (pixel, _) = random_match(rng, truth);
            (pixel, lift(truth, pixel, 5.0 / (1.0 + 0.3 * CAMERA.unproject(pixel).x)))
        });
        (pairs.map(|(pixel, _)| random_line(rng, pixel)), pairs.map(|(_, point)| point))
    });
    assert!(planar >= 0.995, "{planar}");
    let far = found_share("far scene", 22, 10_000, |rng, truth| {
        let pairs: [_; 6] = std::array::from_fn(|_| {
            let (pixel, _) = random_match(rng, truth);
            (pixel, lift(truth, pixel, rng.random_range(95.0..105.0)))
        });
        (pairs.map(|(pixel, _)| random_line(rng, pixel)), pairs.map(|(_, point)| point))
    });
    assert!(far >= 0.97, "{far}");
}

#[test]
fn degenerate_samples_give_no_pose() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..1000 {
        let truth = random_pose(&mut rng);
        let (lines, points) = anchored(6)(&mut rng, &truth);
        assert_eq!(p6lp(&lines, &points, &mut ArrayVec::new()), 0, "six lines of one anchor");

        let (lines, mut points) = anchored(3)(&mut rng, &truth);
        assert_eq!(p6lp(&[lines[0]; 6], &points, &mut ArrayVec::new()), 0, "one line six times");
        points[2] = Point3::new(f64::NAN, 0.0, 0.0);
        assert_eq!(p6lp(&lines, &points, &mut ArrayVec::new()), 0, "NaN");
        points[2] = Point3::new(f64::INFINITY, 0.0, 0.0);
        assert_eq!(p6lp(&lines, &points, &mut ArrayVec::new()), 0, "infinity");
        assert_eq!(p6lp(&lines, &[points[0]; 6], &mut ArrayVec::new()), 0, "one point six times");
    }
}

#[test]
fn equal_input_gives_equal_output() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let truth = random_pose(&mut rng);
    let (lines, points) = anchored(3)(&mut rng, &truth);
    let (mut first, mut second) = (ArrayVec::new(), ArrayVec::new());
    p6lp(&lines, &points, &mut first);
    p6lp(&lines, &points, &mut second);
    assert_eq!(first, second);
}
