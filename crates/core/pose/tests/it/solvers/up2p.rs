//! `up2p` on random problems: the true pose is found, what is returned is valid, degenerate samples give nothing.
#![expect(clippy::print_stderr, reason = "prints the measured shares")]

use super::support;

use std::f64::consts::PI;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_geometry::{CameraFromWorld, Pixel, Point3};
use veiloc_pose::solvers::{ArrayVec, GravityAlignment, up2p};

/// The shares of samples whose true pose was found to 1e-5, and to 1e-2, after checking every pose.
fn found_shares(
    name: &str,
    seed: u64,
    mut pose: impl FnMut(&mut ChaCha8Rng, &Vector3<f64>) -> CameraFromWorld,
    mut sample: impl FnMut(&mut ChaCha8Rng) -> (Pixel, f64),
) -> [f64; 2] {
    let count = 20_000;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut found, mut returned) = ([0; 2], 0);
    for _ in 0..count {
        let down = random_direction(&mut rng);
        let truth = pose(&mut rng, &down);
        let seen = truth.rotation() * down;
        let pairs: [_; 2] = std::array::from_fn(|_| sample(&mut rng));
        let points = pairs.map(|(pixel, depth)| lift(&truth, pixel, depth));
        let bearings = pairs.map(|(pixel, _)| CAMERA.unproject(pixel).bearing());
        let gravity = GravityAlignment::new(&seen, &(down * 0.1)).expect("two directions");
        let mut poses = ArrayVec::new();
        assert_eq!(up2p(&bearings, &points, &gravity, &mut poses), poses.len());
        for pose in &poses {
            let r = pose.rotation().matrix();
            assert!((r * r.transpose()).is_identity(1e-9));
            assert!((r * down - seen).norm() < 1e-9);
            for (bearing, point) in bearings.iter().zip(&points) {
                let p = pose.transform(point).coords;
                assert!(bearing.dot(&p) > 0.0);
                assert!(bearing.cross(&p).norm() < 1e-6 * p.norm(), "{name}");
            }
        }
        returned += poses.len();
        for (found, tolerance) in found.iter_mut().zip([1e-5, 1e-2]) {
            *found += usize::from(poses.iter().any(|p| difference(p, &truth) < tolerance));
        }
    }
    let shares = found.map(|f| f as f64 / f64::from(count));
    let per_sample = returned as f64 / f64::from(count);
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

fn anywhere(rng: &mut ChaCha8Rng) -> (Pixel, f64) {
    (Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)), rng.random_range(1.0..11.0))
}

#[test]
fn the_true_pose_is_found() {
    let [share, _] = found_shares("general", 1, any_pose, anywhere);
    assert!(share >= 0.999, "{share}");
}

#[test]
fn all_angles_about_the_vertical_are_found() {
    for (k, off) in [0.0, 1e-12, -1e-8].into_iter().enumerate() {
        for quarter in 0..4 {
            let turned = |rng: &mut ChaCha8Rng, down: &Vector3<f64>| {
                let angle = f64::from(quarter) * 0.5 * PI + off;
                let r = Rotation3::from_axis_angle(&Unit::new_normalize(*down), angle);
                CameraFromWorld::new(r, Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)))
            };
            let name = format!("{quarter} quarter turns + {off:e}");
            let [share, _] = found_shares(&name, 10 + 4 * k as u64 + quarter as u64, turned, anywhere);
            assert!(share >= 0.999, "{name}: {share}");
        }
    }
}

#[test]
fn near_degenerate_samples() {
    let [share, coarse] = found_shares("narrow", 71, any_pose, |rng| {
        let mut off = || rng.random_range(-2.0..2.0);
        (Pixel::new(320.0 + off(), 240.0 + off()), rng.random_range(2.0..8.0))
    });
    assert!(share >= 0.99 && coarse >= 0.999, "{share} {coarse}");
    let [share, coarse] =
        found_shares("far and flat", 72, any_pose, |rng| (anywhere(rng).0, rng.random_range(99.99..100.01)));
    assert!(share >= 0.99 && coarse >= 0.999, "{share} {coarse}");
}

#[test]
fn degenerate_samples_give_no_pose() {
    let down = Vector3::new(0.1, 1.0, -0.2);
    let gravity = GravityAlignment::new(&down, &down).expect("two directions");
    let b = [Vector3::z(), Vector3::new(0.1, 0.05, 1.0).normalize()];
    let x = [Point3::<World>::new(0.0, 0.0, 4.0), Point3::new(0.4, 0.2, 4.0)];
    let none =
        |b: &[Vector3<f64>; 2], x: &[Point3<World>; 2]| up2p(b, x, &gravity, &mut ArrayVec::new()) == 0;
    assert!(!none(&b, &x));
    assert!(none(&b, &[x[0]; 2]), "one point twice");
    assert!(none(&[b[0]; 2], &x), "one ray twice");
    assert!(none(&b, &[x[0], Point3::from_vector(x[0].coords + down)]), "one vertical");
    assert!(none(&[b[0], Vector3::repeat(f64::NAN)], &x), "NaN ray");
    assert!(none(&b, &[x[0], Point3::new(0.0, f64::NAN, 0.0)]), "NaN point");
    assert!(none(&b, &[x[0], Point3::new(0.0, f64::INFINITY, 0.0)]), "infinite point");
}
