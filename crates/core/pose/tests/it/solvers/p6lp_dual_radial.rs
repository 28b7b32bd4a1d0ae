//! `p6lp_dual_radial` on random problems: the true pose is found, what is returned is valid, and it agrees with `p6lp`.
#![expect(clippy::print_stderr, reason = "prints the measured shares")]

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld, Pixel, PlaneLine, Point3};
use veiloc_pose::solvers::{ArrayVec, HalfPlane, p6lp, p6lp_dual_radial};

/// Five half-planes of one anchor and one of the other, with their points.
struct Sample {
    anchor: Vector3<f64>,
    inward: [Vector3<f64>; 5],
    sixth: HalfPlane,
    points: [Point3<World>; 6],
}

impl Sample {
    fn solve(&self) -> ArrayVec<CameraFromWorld, 4> {
        let mut poses = ArrayVec::new();
        let appended = p6lp_dual_radial(&self.anchor, &self.inward, &self.sixth, &self.points, &mut poses);
        assert_eq!(appended, poses.len());
        poses
    }

    fn half_planes(&self) -> [HalfPlane; 6] {
        let of = |i: usize| HalfPlane { axis: self.anchor, inward: self.inward[i] };
        [of(0), of(1), of(2), of(3), of(4), self.sixth]
    }
}

/// The half-plane of an anchor that a pixel lies in, its directions of any length and either sign of the axis.
fn half_plane(rng: &mut ChaCha8Rng, anchor: Anchor, pixel: Pixel) -> HalfPlane {
    let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let axis = ray_of(anchor) * (sign * rng.random_range(0.1..10.0));
    let inward = CAMERA.unproject(pixel).homogeneous() * rng.random_range(0.1..10.0);
    HalfPlane { axis, inward }
}

fn sample(
    rng: &mut ChaCha8Rng,
    anchor: Anchor,
    mut pair: impl FnMut(&mut ChaCha8Rng, Anchor) -> (Pixel, Point3<World>),
) -> Sample {
    let pairs: [_; 6] = std::array::from_fn(|i| pair(rng, if i < 5 { anchor } else { other(anchor) }));
    let inward = std::array::from_fn(|i| half_plane(rng, anchor, pairs[i].0).inward);
    let sixth = half_plane(rng, other(anchor), pairs[5].0);
    Sample { anchor: ray_of(anchor), inward, sixth, points: pairs.map(|(_, point)| point) }
}

/// The shares of samples whose true pose was found to 1e-5, and to 1e-2, after checking every pose.
fn found_shares(
    name: &str,
    seed: u64,
    count: usize,
    mut pair: impl FnMut(&mut ChaCha8Rng, &CameraFromWorld, Anchor) -> (Pixel, Point3<World>),
) -> [f64; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut found, mut returned) = ([0; 2], 0);
    for k in 0..count {
        let truth = random_pose(&mut rng);
        let sample = sample(&mut rng, Anchor::BOTH[k % 2], |rng, anchor| pair(rng, &truth, anchor));
        let poses = sample.solve();
        for pose in &poses {
            let r = pose.rotation().matrix();
            assert!((r * r.transpose()).is_identity(1e-9));
            for (half, point) in sample.half_planes().iter().zip(&sample.points) {
                let p = pose.transform(point).coords;
                let n = half.normal().normalize();
                assert!(n.dot(&p).abs() < 1e-5 * (1.0 + p.norm()), "{name}: {}", n.dot(&p));
                assert!(half.contains(&p), "{name}: {half:?} {p:?}");
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

#[test]
fn the_true_pose_is_found() {
    let [share, _] = found_shares("general", 1, 50_000, random_match_on);
    assert!(share >= 0.999, "{share}");
}

#[test]
fn near_degenerate_samples_still_give_valid_poses() {
    let [share, coarse] = found_shares("near-planar", 21, 20_000, |rng, truth, anchor| {
        let (pixel, _) = random_match_on(rng, truth, anchor);
        let depth = 5.0 / (1.0 + 0.3 * CAMERA.unproject(pixel).x) + rng.random_range(-1e-3..1e-3);
        (pixel, lift(truth, pixel, depth))
    });
    assert!(share >= 0.98 && coarse >= 0.999, "{share} {coarse}");
    let [share, coarse] = found_shares("far", 22, 20_000, |rng, truth, anchor| {
        let (pixel, _) = random_match_on(rng, truth, anchor);
        (pixel, lift(truth, pixel, rng.random_range(95.0..105.0)))
    });
    assert!(share >= 0.98 && coarse >= 0.999, "{share} {coarse}");
    let [_, coarse] = found_shares("close together", 23, 20_000, |rng, truth, anchor| {
        let center = if anchor == Anchor::FIRST { 160.0 } else { 480.0 };
        let mut off = || rng.random_range(-4.0..4.0);
        let pixel = Pixel::new(center + off(), 240.0 + off());
        (pixel, lift(truth, pixel, rng.random_range(3.0..5.0)))
    });
    assert!(coarse >= 0.99, "{coarse}");
}

#[test]
fn poses_equal_those_of_p6lp_in_the_half_planes() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut missing, mut compared) = (0, 0);
    for _ in 0..10_000 {
        let truth = random_pose(&mut rng);
        let sample = sample(&mut rng, Anchor::FIRST, |rng, anchor| random_match_on(rng, &truth, anchor));
        let halves = sample.half_planes();
        let lines = halves.map(|h| PlaneLine::from_normal(h.normal()).expect("a line"));
        let mut all = ArrayVec::new();
        p6lp(&lines, &sample.points, &mut all);
        let on_halves = |p: &&CameraFromWorld| {
            halves.iter().zip(&sample.points).all(|(h, x)| h.contains(&p.transform(x).coords))
        };
        let ours = sample.solve();
        let slow: Vec<_> = all.iter().filter(on_halves).collect();
        compared += slow.len();
        missing += slow.iter().filter(|s| !ours.iter().any(|p| difference(p, s) < 1e-3)).count();
        missing += ours.iter().filter(|p| !slow.iter().any(|s| difference(p, s) < 1e-3)).count();
    }
    assert!(compared >= 10_000, "{compared}");
    assert!(missing * 500 <= compared, "{missing} of {compared} differ");
}

#[test]
fn pose_is_equivariant_under_similarities() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut near, mut total) = (0, 0);
    for _ in 0..2000 {
        let truth = random_pose(&mut rng);
        let mut sample = sample(&mut rng, Anchor::SECOND, |rng, anchor| random_match_on(rng, &truth, anchor));
        let plain = sample.solve();
        let (turn, scale) = (random_rotation(&mut rng), 10.0_f64.powf(rng.random_range(-2.0..2.0)));
        let shift = Vector3::from_fn(|_, _| rng.random_range(-5.0..5.0));
        sample.points = sample.points.map(|p| Point3::from_vector(turn * p.coords * scale + shift));
        let after = sample.solve();
        for pose in &plain {
            let r = pose.rotation() * turn.inverse();
            let expected = CameraFromWorld::new(r, pose.translation() * scale - r * shift);
            let error = |p: &CameraFromWorld| {
                p.rotation_error_degrees(&expected).to_radians().max(p.translation_error(&expected) / scale)
            };
            near += usize::from(after.iter().any(|p| error(p) < 1e-4));
            total += 1;
        }
    }
    assert!(total >= 2000 && near * 1000 >= total * 998, "{near} of {total}");
}

#[test]
fn degenerate_samples_give_no_pose() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..500 {
        let truth = random_pose(&mut rng);
        let good = || {
            let mut rng = ChaCha8Rng::seed_from_u64(7);
            sample(&mut rng, Anchor::FIRST, |rng, anchor| random_match_on(rng, &truth, anchor))
        };
        assert!(!good().solve().is_empty());
        let mut bad = good();
        bad.sixth.inward = ray_of(Anchor::FIRST);
        assert!(bad.solve().is_empty(), "the sixth through both anchors");
        let mut bad = good();
        bad.sixth.inward = -bad.sixth.inward;
        assert!(bad.solve().iter().all(|p| difference(p, &truth) > 1e-3), "the other half of the sixth");
        let mut bad = good();
        bad.sixth.inward = Vector3::zeros();
        assert!(bad.solve().is_empty(), "no direction");
        let mut bad = good();
        bad.anchor = Vector3::new(f64::NAN, 0.0, 1.0);
        assert!(bad.solve().is_empty(), "NaN anchor");
        let mut bad = good();
        bad.points[5] = Point3::new(f64::NAN, 0.0, 0.0);
        assert!(bad.solve().is_empty(), "NaN point");
        let mut bad = good();
        bad.points = [bad.points[0]; 6];
        assert!(bad.solve().is_empty(), "one point six times");
    }
}
