//! `u4lp` on random problems: the true pose is found, what is returned is valid, degenerate samples give nothing.
#![expect(clippy::print_stderr, reason = "prints the measured shares")]

use super::support;

use std::f64::consts::PI;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_geometry::{Anchor, CameraFromWorld, Pixel, PlaneLine, Point3};
use veiloc_pose::solvers::{ArrayVec, GravityAlignment, u4lp};

type Sample = ([PlaneLine; 4], [Point3<World>; 4]);

/// The shares of samples whose true pose was found to 1e-5, and to 1e-2, after checking every pose.
fn found_shares(
    name: &str,
    seed: u64,
    count: usize,
    mut pose: impl FnMut(&mut ChaCha8Rng, &Vector3<f64>) -> CameraFromWorld,
    mut sample: impl FnMut(&mut ChaCha8Rng, &CameraFromWorld) -> Sample,
) -> [f64; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut found, mut returned) = ([0; 2], 0);
    for _ in 0..count {
        let down = random_direction(&mut rng);
        let truth = pose(&mut rng, &down);
        let (lines, points) = sample(&mut rng, &truth);
        let seen = truth.rotation() * down;
        let gravity = GravityAlignment::new(&(seen * 9.81), &down).expect("two directions");
        let mut poses = ArrayVec::new();
        assert_eq!(u4lp(&lines, &points, &gravity, &mut poses), poses.len());
        for pose in &poses {
            let r = pose.rotation().matrix();
            assert!((r * r.transpose()).is_identity(1e-9));
            assert!((r * down - seen).norm() < 1e-9);
            for (line, point) in lines.iter().zip(&points) {
                let p = pose.transform(point);
                assert!(p.depth() > 0.0);
                let off = line.normal().dot(&p.coords).abs();
                assert!(off <= 1e-6 * (1.0 + p.coords.norm()), "{name}: {off} at {}", p.coords.norm());
            }
        }
        returned += poses.len();
        for (found, tolerance) in found.iter_mut().zip([1e-5, 1e-2]) {
            *found += usize::from(poses.iter().any(|p| difference(p, &truth) < tolerance));
        }
    }
    let shares = found.map(|f| f as f64 / count as f64);
    let per_sample = returned as f64 / count as f64;
    eprintln!(
        "{name}: found {:.3} / {:.3} %, {per_sample:.2} poses a sample",
        100.0 * shares[0],
        100.0 * shares[1]
    );
    shares
}

fn any_pose(rng: &mut ChaCha8Rng, _: &Vector3<f64>) -> CameraFromWorld {
    random_pose(rng)
}

fn random_lines(rng: &mut ChaCha8Rng, truth: &CameraFromWorld) -> Sample {
    let pairs: [_; 4] = std::array::from_fn(|_| random_match(rng, truth));
    (pairs.map(|(pixel, _)| random_line(rng, pixel)), pairs.map(|(_, point)| point))
}

fn anchored(split: usize) -> impl FnMut(&mut ChaCha8Rng, &CameraFromWorld) -> Sample {
    move |rng, truth| {
        let pairs: [_; 4] = std::array::from_fn(|i| {
            random_match_on(rng, truth, if i < split { Anchor::FIRST } else { Anchor::SECOND })
        });
        (pairs.map(|(pixel, _)| dcl_line(pixel)), pairs.map(|(_, point)| point))
    }
}

#[test]
fn the_true_pose_is_found() {
    let [share, _] = found_shares("random lines", 1, 50_000, any_pose, random_lines);
    assert!(share >= 0.999, "{share}");
    for split in 1..=3 {
        let name = format!("dcl {split}+{}", 4 - split);
        let [share, _] = found_shares(&name, 10 + split as u64, 20_000, any_pose, anchored(split));
        assert!(share >= 0.999, "{split}: {share}");
    }
}

#[test]
fn all_angles_about_the_vertical_are_found() {
    // The chart tan θ/2 fails at half turns; here every multiple of a quarter turn, exact and nearly so.
    for (k, off) in [0.0, 1e-12, -1e-8, 1e-4].into_iter().enumerate() {
        for quarter in 0..4 {
            let turned = |rng: &mut ChaCha8Rng, down: &Vector3<f64>| {
                let angle = f64::from(quarter) * 0.5 * PI + off;
                let r = Rotation3::from_axis_angle(&Unit::new_normalize(*down), angle);
                CameraFromWorld::new(r, Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)))
            };
            let name = format!("{quarter} quarter turns + {off:e}");
            let [share, _] =
                found_shares(&name, 40 + 4 * k as u64 + quarter as u64, 2000, turned, random_lines);
            assert!(share >= 0.998, "{name}: {share}");
        }
    }
}

#[test]
fn near_degenerate_samples_still_give_valid_poses() {
    let spread = |spread: f64, depth: std::ops::Range<f64>| {
        move |rng: &mut ChaCha8Rng, truth: &CameraFromWorld| {
            let pairs: [_; 4] = std::array::from_fn(|_| {
                let mut off = || rng.random_range(-spread..spread);
                let pixel = Pixel::new(320.0 + off(), 240.0 + off());
                (pixel, lift(truth, pixel, rng.random_range(depth.clone())))
            });
            (pairs.map(|(pixel, _)| random_line(rng, pixel)), pairs.map(|(_, point)| point))
        }
    };
    let [share, coarse] = found_shares("narrow", 71, 20_000, any_pose, spread(8.0, 2.0..8.0));
    assert!(share >= 0.99 && coarse >= 0.999, "{share} {coarse}");
    let [share, coarse] = found_shares("far and flat", 72, 20_000, any_pose, spread(240.0, 99.9..100.1));
    assert!(share >= 0.99 && coarse >= 0.999, "{share} {coarse}");
    let [_, coarse] = found_shares("close together", 73, 20_000, any_pose, spread(0.1, 4.0..4.001));
    assert!(coarse >= 0.9, "{coarse}");
    // Lines through almost the same image point.
    let crossing = |rng: &mut ChaCha8Rng, truth: &CameraFromWorld| {
        let pairs: [_; 4] = std::array::from_fn(|_| random_match(rng, truth));
        let lines = pairs.map(|(pixel, _)| {
            let through =
                Pixel::new(300.0 + rng.random_range(-0.01..0.01), -50.0 + rng.random_range(-0.01..0.01));
            veiloc_geometry::PixelLine::joining(pixel, through).expect("apart").back_project(&CAMERA)
        });
        (lines, pairs.map(|(_, point)| point))
    };
    let [_, coarse] = found_shares("nearly one crossing", 74, 20_000, any_pose, crossing);
    assert!(coarse >= 0.999, "{coarse}");
}

#[test]
fn pose_is_equivariant_under_similarities() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..2000 {
        let truth = random_pose(&mut rng);
        let (lines, points) = random_lines(&mut rng, &truth);
        let down = random_direction(&mut rng);
        let seen = truth.rotation() * down;
        let solve = |lines: &[PlaneLine; 4], points: &[Point3<World>; 4], down: &Vector3<f64>| {
            let mut poses = ArrayVec::new();
            u4lp(lines, points, &GravityAlignment::new(&seen, down).expect("two directions"), &mut poses);
            poses
        };
        let plain = solve(&lines, &points, &down);
        let (turn, scale) = (random_rotation(&mut rng), 10.0_f64.powf(rng.random_range(-2.0..2.0)));
        let shift = Vector3::from_fn(|_, _| rng.random_range(-5.0..5.0));
        let moved = points.map(|p| Point3::from_vector(turn * p.coords * scale + shift));
        let flipped = lines.map(|l| PlaneLine::from_normal(-l.normal()).expect("a line"));
        // Another order of the four pairs as well.
        let (order, order_lines) =
            ([2, 0, 3, 1].map(|i: usize| moved[i]), [2, 0, 3, 1].map(|i: usize| flipped[i]));
        let after = solve(&order_lines, &order, &(turn * down));
        assert_eq!(plain.len(), after.len());
        for pose in &plain {
            let r = pose.rotation() * turn.inverse();
            let expected = CameraFromWorld::new(r, pose.translation() * scale - r * shift);
            let near = after.iter().map(|p| {
                p.rotation_error_degrees(&expected).to_radians().max(p.translation_error(&expected) / scale)
            });
            assert!(near.fold(f64::INFINITY, f64::min) < 1e-4);
        }
    }
}

#[test]
fn degenerate_samples_give_no_pose() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..1000 {
        let truth = random_pose(&mut rng);
        let down = random_direction(&mut rng);
        let gravity = GravityAlignment::new(&(truth.rotation() * down), &down).expect("two directions");
        let none = |lines: &[PlaneLine; 4], points: &[Point3<World>; 4]| {
            u4lp(lines, points, &gravity, &mut ArrayVec::new()) == 0
        };
        let (lines, points) = anchored(4)(&mut rng, &truth);
        assert!(none(&lines, &points), "four lines of one anchor");
        let (lines, points) = anchored(2)(&mut rng, &truth);
        assert!(!none(&lines, &points));
        assert!(none(&[lines[0]; 4], &points), "one line four times");
        assert!(none(&lines, &[points[0]; 4]), "one point four times");
        let with = |x: f64| [points[0], points[1], Point3::new(x, 0.0, 0.0), points[3]];
        assert!(none(&lines, &with(f64::NAN)), "NaN");
        assert!(none(&lines, &with(f64::INFINITY)), "infinity");
        let column: [Point3<World>; 4] =
            std::array::from_fn(|i| Point3::from_vector(points[0].coords + down * i as f64));
        let lines = std::array::from_fn(|i| random_line(&mut rng, Pixel::new(100.0 * i as f64, 240.0)));
        assert!(none(&lines, &column), "points on one vertical");
    }
}
