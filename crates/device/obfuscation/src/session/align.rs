//! Rotation of a frame relative to the session's layout, estimated from the directions of matched keypoints.
//!
//! A camera that rests or turns on the spot sees all directions rotated by one rotation, which keypoints determine more
//! accurately than a gyroscope. A moving camera sees parallax: no rotation fits, and the measured rotation is used.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};

/// Two directions of one scene point: unit vectors in the layout's frame and in the camera's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DirectionPair {
    pub(super) layout: Vector3<f64>,
    pub(super) camera: Vector3<f64>,
}

/// Inlier thresholds of the successive refinements, from coarse to fine, degrees.
const THRESHOLDS_DEG: [f64; 5] = [2.0, 1.0, 0.5, 0.3, INLIER_DEG];
/// Final inlier threshold, degrees: a pixel or two.
const INLIER_DEG: f64 = 0.2;
/// Minimum number and share of inliers, with a measured rotation and without one. Without, two thirds must be inliers;
/// this excludes chance, and surfaces whose parallax resembles a rotation.
const MIN_INLIERS: usize = 12;
const MIN_INLIER_SHARE: f64 = 0.4;
const MIN_INLIERS_UNMEASURED: usize = 30;
const MIN_SHARE_UNMEASURED: f64 = 0.67;
/// Two-pair samples that are tried where no rotation was measured.
const SAMPLES: usize = 300;

/// The rotation near a measured one that fits the pairs; the measured one if none within `limit` (radians) of it fits.
pub(super) fn refine_rotation(
    pairs: &[DirectionPair],
    cam_from_layout: Rotation3<f64>,
    limit: f64,
) -> Rotation3<f64> {
    match refit(pairs, cam_from_layout) {
        Some((found, agree))
            if agree >= MIN_INLIERS
                && agree as f64 >= MIN_INLIER_SHARE * pairs.len() as f64
                && found.angle_to(&cam_from_layout) <= limit =>
        {
            found
        }
        _ => cam_from_layout,
    }
}

/// The rotation that fits nearly all pairs, without a measured one; `None` when the camera has moved, or sees another
/// scene.
///
/// Deterministic: equal pairs give equal results.
pub(super) fn estimate_rotation(pairs: &[DirectionPair]) -> Option<Rotation3<f64>> {
    if pairs.len() < MIN_INLIERS_UNMEASURED {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(pairs.len() as u64);
    let of_two = |_| {
        let [a, b] = [0; 2].map(|_| &pairs[rng.random_range(0..pairs.len())]);
        let frame = |x: Vector3<f64>, y: Vector3<f64>| {
            let z = x.cross(&y).try_normalize(0.02)?;
            Some(Matrix3::from_columns(&[x, z, x.cross(&z)]))
        };
        let rotation = frame(a.camera, b.camera)? * frame(a.layout, b.layout)?.transpose();
        Some(Rotation3::from_matrix_unchecked(rotation))
    };
    let tried: Vec<Rotation3<f64>> = (0..SAMPLES).filter_map(of_two).collect();
    let best = tried.iter().max_by_key(|r| inliers(pairs, r, THRESHOLDS_DEG[2]).count())?;
    let (found, agree) = refit(pairs, *best)?;
    (agree >= MIN_INLIERS_UNMEASURED && agree as f64 >= MIN_SHARE_UNMEASURED * pairs.len() as f64)
        .then_some(found)
}

fn inliers<'a>(
    pairs: &'a [DirectionPair],
    rotation: &Rotation3<f64>,
    degrees: f64,
) -> impl Iterator<Item = &'a DirectionPair> + use<'a> {
    let (rotation, within) = (*rotation, degrees.to_radians().cos());
    pairs.iter().filter(move |p| (rotation * p.layout).dot(&p.camera) >= within)
}

/// Repeated least squares on the inliers; returns the rotation and the final number of inliers.
fn refit(pairs: &[DirectionPair], start: Rotation3<f64>) -> Option<(Rotation3<f64>, usize)> {
    let mut rotation = start;
    for degrees in THRESHOLDS_DEG {
        rotation = least_squares(inliers(pairs, &rotation, degrees))?;
    }
    Some((rotation, inliers(pairs, &rotation, INLIER_DEG).count()))
}

/// The rotation with the least sum of squares (Kabsch, 1976).
fn least_squares<'a>(pairs: impl Iterator<Item = &'a DirectionPair>) -> Option<Rotation3<f64>> {
    let covariance: Matrix3<f64> = pairs.map(|p| p.camera * p.layout.transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Coplanar directions do not determine a rotation.
    (svd.singular_values[1] > 1e-6).then_some(())?;
    let mirrored = (u * v_t).determinant() < 0.0;
    let fix = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, if mirrored { -1.0 } else { 1.0 }));
    Some(Rotation3::from_matrix_unchecked(u * fix * v_t))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs of a camera with this rotation; those from index `right` on are outliers; all have noise (radians).
    fn pairs(turn: &Rotation3<f64>, count: usize, right: usize, noise: f64) -> Vec<DirectionPair> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut step = |most: f64| most * rng.random_range(-1.0..=1.0);
        (0..count)
            .map(|i| {
                let layout = Vector3::new(step(0.6), step(0.45), 1.0).normalize();
                let moved = Vector3::new(step(noise), step(noise), step(noise));
                let wrong = Vector3::new(step(0.6), step(0.45), 1.0).normalize();
                let camera = if i < right { (turn * layout + moved).normalize() } else { wrong };
                DirectionPair { layout, camera }
            })
            .collect()
    }

    #[test]
    fn rotation_is_found_among_outliers() {
        let turn = Rotation3::from_euler_angles(0.2, -0.3, 0.4);
        let pairs = pairs(&turn, 200, 160, 1e-3);
        let found = estimate_rotation(&pairs).expect("most agree");
        assert!(found.angle_to(&turn) < 3e-4, "{}", found.angle_to(&turn));
        let measured = Rotation3::from_euler_angles(0.2, -0.297, 0.4);
        assert!(refine_rotation(&pairs, measured, 0.01).angle_to(&turn) < 3e-4);
        // A rotation farther from the measured one than the allowed error is parallax.
        assert_eq!(refine_rotation(&pairs, measured, 0.001), measured);
    }

    #[test]
    fn inconsistent_pairs_give_no_rotation() {
        let turn = Rotation3::from_euler_angles(0.2, -0.3, 0.4);
        for (count, right) in [(200, 100), (29, 29), (0, 0), (200, 0)] {
            assert!(estimate_rotation(&pairs(&turn, count, right, 1e-3)).is_none(), "{right} of {count}");
        }
        assert_eq!(refine_rotation(&pairs(&turn, 200, 60, 1e-3), turn, 0.01), turn);
        assert_eq!(refine_rotation(&[], turn, 0.01), turn);
        // All directions equal.
        let one = DirectionPair { layout: Vector3::z(), camera: turn * Vector3::z() };
        assert!(estimate_rotation(&[one; 50]).is_none());
        // A camera that moved sideways in front of points at different depths.
        let parallax = pairs(&Rotation3::identity(), 200, 200, 0.0).into_iter().enumerate().map(|(i, p)| {
            let camera = (p.layout * (2.0 + i as f64 / 50.0) + Vector3::x() * 0.1).normalize();
            DirectionPair { camera, ..p }
        });
        assert!(estimate_rotation(&parallax.collect::<Vec<_>>()).is_none());
    }
}
