//! How a frame is turned against what the session has seen: the rotation that the directions of matched keypoints agree on.
//!
//! A camera that rests or turns on the spot sees every direction turned by one rotation, which keypoints tell better than a
//! gyroscope. A camera that moves sees parallax, no rotation fits, and what the device measured is believed.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};

/// Directions of one thing: unit vectors in the layout's frame and in the camera's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    pub(super) layout: Vector3<f64>,
    pub(super) camera: Vector3<f64>,
}

/// Angles within which pairs agree, from coarse to fine, degrees.
const WITHIN_DEG: [f64; 5] = [2.0, 1.0, 0.5, 0.3, AGREE_DEG];
/// Pairs that agree are at most this far apart, degrees: a pixel or two.
const AGREE_DEG: f64 = 0.2;
/// Fewest pairs that tell a rotation, and their share, with and without a measured one to compare with. Without, two thirds must
/// agree, so that it is no chance and no surface that a moving camera sees like a turning one.
const FEWEST: usize = 12;
const SHARE: f64 = 0.4;
const FEWEST_ALONE: usize = 30;
const SHARE_ALONE: f64 = 0.67;
/// Rotations of two pairs that are tried where none was measured.
const DRAWS: usize = 300;

/// The rotation near a measured one that the pairs agree on; the measured one where they agree on none within `limit` of it,
/// radians.
pub(super) fn refined(pairs: &[Pair], cam_from_layout: Rotation3<f64>, limit: f64) -> Rotation3<f64> {
    match settled(pairs, cam_from_layout) {
        Some((found, agree))
            if agree >= FEWEST
                && agree as f64 >= SHARE * pairs.len() as f64
                && found.angle_to(&cam_from_layout) <= limit =>
        {
            found
        }
        _ => cam_from_layout,
    }
}

/// The rotation that nearly all pairs agree on, where none was measured; `None` when the camera has moved, or sees something else.
///
/// Equal for equal pairs.
pub(super) fn seen(pairs: &[Pair]) -> Option<Rotation3<f64>> {
    if pairs.len() < FEWEST_ALONE {
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
    let tried: Vec<Rotation3<f64>> = (0..DRAWS).filter_map(of_two).collect();
    let best = tried.iter().max_by_key(|r| agreeing(pairs, r, WITHIN_DEG[2]).count())?;
    let (found, agree) = settled(pairs, *best)?;
    (agree >= FEWEST_ALONE && agree as f64 >= SHARE_ALONE * pairs.len() as f64).then_some(found)
}

fn agreeing<'a>(
    pairs: &'a [Pair],
    rotation: &Rotation3<f64>,
    degrees: f64,
) -> impl Iterator<Item = &'a Pair> + use<'a> {
    let (rotation, within) = (*rotation, degrees.to_radians().cos());
    pairs.iter().filter(move |p| (rotation * p.layout).dot(&p.camera) >= within)
}

/// Least squares on the pairs that agree, again and again; and how many do in the end.
fn settled(pairs: &[Pair], start: Rotation3<f64>) -> Option<(Rotation3<f64>, usize)> {
    let mut rotation = start;
    for degrees in WITHIN_DEG {
        rotation = least_squares(agreeing(pairs, &rotation, degrees))?;
    }
    Some((rotation, agreeing(pairs, &rotation, AGREE_DEG).count()))
}

/// The rotation with the least sum of squares (Kabsch, 1976).
fn least_squares<'a>(pairs: impl Iterator<Item = &'a Pair>) -> Option<Rotation3<f64>> {
    let covariance: Matrix3<f64> = pairs.map(|p| p.camera * p.layout.transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Directions that all lie in a plane or less leave a rotation open.
    (svd.singular_values[1] > 1e-6).then_some(())?;
    let mirrored = (u * v_t).determinant() < 0.0;
    let fix = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, if mirrored { -1.0 } else { 1.0 }));
    Some(Rotation3::from_matrix_unchecked(u * fix * v_t))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs seen by a camera turned so; those beyond `right` go wrong, all are moved by noise (radians).
    fn pairs(turn: &Rotation3<f64>, count: usize, right: usize, noise: f64) -> Vec<Pair> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut step = |most: f64| most * rng.random_range(-1.0..=1.0);
        (0..count)
            .map(|i| {
                let layout = Vector3::new(step(0.6), step(0.45), 1.0).normalize();
                let moved = Vector3::new(step(noise), step(noise), step(noise));
                let wrong = Vector3::new(step(0.6), step(0.45), 1.0).normalize();
                let camera = if i < right { (turn * layout + moved).normalize() } else { wrong };
                Pair { layout, camera }
            })
            .collect()
    }

    #[test]
    fn a_turn_is_found_among_wrong_pairs() {
        let turn = Rotation3::from_euler_angles(0.2, -0.3, 0.4);
        let pairs = pairs(&turn, 200, 160, 1e-3);
        let found = seen(&pairs).expect("most agree");
        assert!(found.angle_to(&turn) < 3e-4, "{}", found.angle_to(&turn));
        let measured = Rotation3::from_euler_angles(0.2, -0.297, 0.4);
        assert!(refined(&pairs, measured, 0.01).angle_to(&turn) < 3e-4);
        // What is farther from the measured one than that errs is parallax.
        assert_eq!(refined(&pairs, measured, 0.001), measured);
    }

    #[test]
    fn what_agrees_on_no_rotation_tells_none() {
        let turn = Rotation3::from_euler_angles(0.2, -0.3, 0.4);
        for (count, right) in [(200, 100), (29, 29), (0, 0), (200, 0)] {
            assert!(seen(&pairs(&turn, count, right, 1e-3)).is_none(), "{right} of {count}");
        }
        assert_eq!(refined(&pairs(&turn, 200, 60, 1e-3), turn, 0.01), turn);
        assert_eq!(refined(&[], turn, 0.01), turn);
        // All in one place.
        let one = Pair { layout: Vector3::z(), camera: turn * Vector3::z() };
        assert!(seen(&[one; 50]).is_none());
        // A camera that moved sideways before things at different depths.
        let parallax = pairs(&Rotation3::identity(), 200, 200, 0.0).into_iter().enumerate().map(|(i, p)| {
            let camera = (p.layout * (2.0 + i as f64 / 50.0) + Vector3::x() * 0.1).normalize();
            Pair { camera, ..p }
        });
        assert!(seen(&parallax.collect::<Vec<_>>()).is_none());
    }
}
