//! `p3p` on random problems: the true pose is found, what is returned is valid, degenerate samples give nothing.
#![expect(clippy::print_stderr, reason = "prints the measured shares")]

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Pixel, Point3};
use veiloc_pose::solvers::{ArrayVec, p3p};

fn found_share(
    name: &str,
    seed: u64,
    count: usize,
    mut depth: impl FnMut(&mut ChaCha8Rng, Pixel) -> f64,
    tolerance: f64,
) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut found, mut returned) = (0, 0);
    for _ in 0..count {
        let truth = random_pose(&mut rng);
        let pixels: [Pixel; 3] = std::array::from_fn(|_| random_match(&mut rng, &truth).0);
        let points = pixels.map(|p| lift(&truth, p, depth(&mut rng, p)));
        let bearings = pixels.map(|p| CAMERA.unproject(p).bearing());
        let mut poses = ArrayVec::new();
        assert_eq!(p3p(&bearings, &points, &mut poses), poses.len());
        for pose in &poses {
            assert!((pose.rotation().matrix() * pose.rotation().matrix().transpose()).is_identity(1e-9));
            for (bearing, point) in bearings.iter().zip(&points) {
                let p = pose.transform(point).coords;
                assert!(bearing.dot(&p) > 0.0);
                assert!(
                    bearing.cross(&p).norm() < 1e-5 * p.norm(),
                    "{name}: {}",
                    bearing.cross(&p).norm() / p.norm()
                );
            }
        }
        returned += poses.len();
        found += usize::from(poses.iter().any(|p: &CameraFromWorld| difference(p, &truth) < tolerance));
    }
    let share = found as f64 / count as f64;
    eprintln!("{name}: found {:.3} %, {:.2} poses a sample", 100.0 * share, returned as f64 / count as f64);
    share
}

#[test]
fn the_true_pose_is_found() {
    let share = found_share("general", 1, 50_000, |rng, _| rng.random_range(1.0..11.0), 1e-5);
    assert!(share >= 0.999, "{share}");
}

#[test]
fn near_degenerate_samples() {
    let far = found_share("far", 2, 20_000, |rng, _| rng.random_range(95.0..105.0), 1e-3);
    assert!(far >= 0.99, "{far}");
    let planar = found_share("facing plane", 3, 20_000, |_, _| 4.0, 1e-4);
    assert!(planar >= 0.99, "{planar}");
}

#[test]
fn degenerate_samples_give_no_pose() {
    let b = [Vector3::z(), Vector3::new(0.1, 0.0, 1.0).normalize(), Vector3::new(0.0, 0.1, 1.0).normalize()];
    let x = [Point3::new(0.0, 0.0, 4.0), Point3::new(0.4, 0.0, 4.0), Point3::new(0.0, 0.4, 4.0)];
    let none = |b: &[Vector3<f64>; 3], x: &[Point3<_>; 3]| p3p(b, x, &mut ArrayVec::new()) == 0;
    assert!(!none(&b, &x));
    assert!(none(&b, &[x[0], x[1], Point3::new(0.8, 0.0, 4.0)]), "collinear");
    assert!(none(&b, &[x[0]; 3]), "one point three times");
    assert!(none(&[b[0]; 3], &x), "one ray three times");
    assert!(none(&[b[0], b[1], Vector3::repeat(f64::NAN)], &x), "NaN ray");
    assert!(none(&b, &[x[0], x[1], Point3::new(f64::NAN, 0.0, 0.0)]), "NaN point");
    assert!(none(&b, &[x[0], x[1], Point3::new(f64::INFINITY, 0.0, 0.0)]), "infinite point");
}
