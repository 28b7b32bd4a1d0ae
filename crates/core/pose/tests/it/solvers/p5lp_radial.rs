//! `p5lp_radial` on random problems: the true pose is found, what is returned is valid, degenerate samples give
//! nothing.

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::*;
use veiloc_geometry::nalgebra::{Rotation3, Vector2, Vector3};
use veiloc_geometry::{Anchor, Point3};
use veiloc_pose::solvers::{ArrayVec, p5lp_radial};

/// The rotation that makes an anchor's ray the optical axis.
fn turn_of(anchor: Anchor) -> Rotation3<f64> {
    Rotation3::rotation_between(&ray_of(anchor), &Vector3::z()).expect("not opposite")
}

#[test]
fn true_pose_is_found_for_five_lines_of_one_anchor() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut found, mut returned, total) = (0, 0, 20_000);
    for k in 0..total {
        let anchor = Anchor::BOTH[k % 2];
        let turn = turn_of(anchor);
        let truth = random_pose(&mut rng);
        let pairs: [_; 5] = std::array::from_fn(|_| random_match_on(&mut rng, &truth, anchor));
        // Any point of the half-line gives its direction: its keypoint, seen from the rotated camera.
        let directions = pairs
            .map(|(pixel, _)| (turn * CAMERA.unproject(pixel).bearing()).xy() * rng.random_range(0.1..10.0));
        let points = pairs.map(|(_, point)| point);
        let mut poses = ArrayVec::new();
        assert_eq!(p5lp_radial(&directions, &points, &mut poses), poses.len());
        for pose in &poses {
            assert!((pose.rotation.matrix() * pose.rotation.matrix().transpose()).is_identity(1e-9));
            for (u, x) in directions.iter().zip(&points) {
                let seen = pose.across(x);
                assert!(u.dot(&seen) > 0.0);
                assert!((u.x * seen.y - u.y * seen.x).abs() < 1e-5 * u.norm() * (1.0 + seen.norm()));
            }
        }
        let (r, t) = (turn * truth.rotation(), (turn * truth.translation()).xy());
        found += usize::from(
            poses
                .iter()
                .any(|p| (p.rotation.matrix() - r.matrix()).norm() < 1e-5 && (p.offset - t).norm() < 1e-4),
        );
        returned += poses.len();
    }
    eprintln!(
        "found {:.3} %, {:.2} poses a sample",
        100.0 * found as f64 / total as f64,
        returned as f64 / total as f64
    );
    assert!(found * 1000 >= total * 999, "{found} of {total}");
}

#[test]
fn degenerate_samples_give_no_pose() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = random_pose(&mut rng);
    let pairs: [_; 5] = std::array::from_fn(|_| random_match_on(&mut rng, &truth, Anchor::FIRST));
    let directions =
        pairs.map(|(pixel, _)| (turn_of(Anchor::FIRST) * CAMERA.unproject(pixel).bearing()).xy());
    let points = pairs.map(|(_, point)| point);
    let none = |u: &[Vector2<f64>; 5], x: &[Point3<_>; 5]| p5lp_radial(u, x, &mut ArrayVec::new()) == 0;
    assert!(!none(&directions, &points));
    assert!(none(&[Vector2::new(f64::NAN, 1.0); 5], &points));
    assert!(none(&[Vector2::zeros(); 5], &points));
    assert!(none(&directions, &[points[0]; 5]));
    assert!(none(&directions, &[Point3::new(f64::INFINITY, 0.0, 0.0); 5]));
    let (mut u, mut x) = (directions, points);
    (u[1], x[1]) = (u[0], x[0]);
    assert!(none(&u, &x), "a repeated pair");
}
