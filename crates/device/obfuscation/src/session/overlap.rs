//! Whether matched keypoints of two frames show one scene: by the geometry of two views, because of thousands of
//! keypoints many match by chance.

use rand::seq::index::sample;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, SMatrix, SVector, SymmetricEigen, Vector3};

use super::align::DirectionPair;

/// Minimum number of pairs.
const MIN_PAIRS: usize = 15;
/// Pairs that must agree with one epipolar geometry. Eight fit always; among pairs of different scenes at most 14 did, of
/// one scene at least 23 (decision 0046).
const MIN_EPIPOLAR: usize = 18;
/// Pairs that must agree with one homography. Four fit always; among pairs of different scenes at most 8 did.
const MIN_HOMOGRAPHY: usize = 11;
/// Largest errors of a pair that agrees, on the plane one focal length away: two pixels of a camera with a focal length
/// of 500, and four.
const EPIPOLAR_ERROR: f64 = 0.004;
const HOMOGRAPHY_ERROR: f64 = 0.008;
/// Samples that are tried.
const SAMPLES: usize = 300;
/// Directions farther than this from the mean one are not used (cosine).
const MIN_COSINE: f64 = 0.2;

type Vector9 = SVector<f64, 9>;
type Matrix9 = SMatrix<f64, 9, 9>;

/// Two positions of one keypoint, on the planes one focal length away: in the layout's frame, and in the camera's.
struct PlanePair {
    layout: Vector3<f64>,
    camera: Vector3<f64>,
}

/// Whether enough pairs agree with one epipolar geometry, or with one homography, so that they belong to one scene, seen
/// by a camera that rested, turned or moved. Needs no exact focal length.
///
/// Deterministic: equal pairs give equal results.
pub(super) fn is_one_scene(pairs: &[DirectionPair]) -> bool {
    let Some(pairs) = plane_pairs(pairs).filter(|pairs| pairs.len() >= MIN_PAIRS) else { return false };
    let mut rng = ChaCha8Rng::seed_from_u64(pairs.len() as u64);
    (0..SAMPLES).any(|_| {
        epipolar_inliers(&pairs, &mut rng) >= MIN_EPIPOLAR
            || homography_inliers(&pairs, &mut rng) >= MIN_HOMOGRAPHY
    })
}

/// The pairs in two frames whose third axes are the mean directions, scaled as Hartley (1997) does.
fn plane_pairs(pairs: &[DirectionPair]) -> Option<Vec<PlanePair>> {
    let plane = |of: &dyn Fn(&DirectionPair) -> Vector3<f64>| {
        let mean: Vector3<f64> = pairs.iter().map(of).sum();
        let ahead = mean.try_normalize(1e-6)?;
        let turn = Rotation3::rotation_between(&ahead, &Vector3::z())
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        Some(pairs.iter().map(|pair| turn * of(pair)).collect::<Vec<_>>())
    };
    let (layout, camera) = (plane(&|pair| pair.layout)?, plane(&|pair| pair.camera)?);
    let ahead = layout.into_iter().zip(camera).filter(|(l, c)| l.z.min(c.z) > MIN_COSINE);
    Some(ahead.map(|(l, c)| PlanePair { layout: l / l.z, camera: c / c.z }).collect())
}

/// The number of pairs that agree with the epipolar geometry of eight random ones.
fn epipolar_inliers(pairs: &[PlanePair], rng: &mut impl Rng) -> usize {
    let row = |pair: &PlanePair| {
        let outer = pair.camera * pair.layout.transpose();
        Vector9::from_iterator(outer.iter().copied())
    };
    let agree = |of: &Matrix3<f64>| -> Vec<&PlanePair> {
        let close = |pair: &&PlanePair| {
            let (line, back) = (of * pair.layout, of.transpose() * pair.camera);
            let slope = line.x * line.x + line.y * line.y + back.x * back.x + back.y * back.y;
            pair.camera.dot(&line).powi(2) < EPIPOLAR_ERROR * EPIPOLAR_ERROR * slope
        };
        pairs.iter().filter(close).collect()
    };
    let of_sample = null_matrix(sample(rng, pairs.len(), 8).iter().map(|i| row(&pairs[i])));
    let found = agree(&of_sample);
    if found.len() <= 8 {
        return found.len();
    }
    found.len().max(agree(&null_matrix(found.into_iter().map(row))).len())
}

/// The number of pairs that agree with the homography of four random ones.
fn homography_inliers(pairs: &[PlanePair], rng: &mut impl Rng) -> usize {
    let rows = |pair: &PlanePair| {
        let (from, to) = (pair.layout, pair.camera);
        let row = |columns: [Vector3<f64>; 3]| {
            Vector9::from_iterator(columns.iter().flat_map(|c| c.iter().copied()))
        };
        // By rows of the homography.
        [row([Vector3::zeros(), -from, from * to.y]), row([from, Vector3::zeros(), -from * to.x])]
    };
    let chosen = sample(rng, pairs.len(), 4);
    let homography = null_matrix(chosen.iter().flat_map(|i| rows(&pairs[i]))).transpose();
    let agrees = |pair: &&PlanePair| {
        let shown = homography * pair.layout;
        shown.z.abs() > 1e-12 && (shown / shown.z - pair.camera).norm() < HOMOGRAPHY_ERROR
    };
    pairs.iter().filter(agrees).count()
}

/// The matrix, by columns, that is most nearly orthogonal to all of these.
fn null_matrix(rows: impl Iterator<Item = Vector9>) -> Matrix3<f64> {
    let all: Matrix9 = rows.map(|row| row * row.transpose()).sum();
    let eigen = SymmetricEigen::new(all);
    Matrix3::from_iterator(eigen.eigenvectors.column(eigen.eigenvalues.imin()).iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs of which the first `right` are of one scene, seen by a camera that moved by `step` and turned; the others
    /// are arbitrary. `depth`: how much depths vary.
    fn pairs(seed: u64, count: usize, right: usize, step: f64, depth: f64) -> Vec<DirectionPair> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let turn = Rotation3::from_euler_angles(0.9, -2.1, 0.4);
        let mut any = |most: f64| most * rng.random_range(-1.0..=1.0);
        (0..count)
            .map(|i| {
                let layout = Vector3::new(any(0.6), any(0.45), 1.0);
                let moved = layout * (3.0 + any(depth)) + Vector3::new(step, 0.3 * step, 0.0);
                let noise = Vector3::new(any(1e-3), any(1e-3), 0.0);
                let other = Vector3::new(any(0.6), any(0.45), 1.0);
                let camera = if i < right { moved / moved.z + noise } else { other };
                DirectionPair { layout: (turn * layout).normalize(), camera: camera.normalize() }
            })
            .collect()
    }

    #[test]
    fn one_scene_is_recognized_whatever_the_camera_did() {
        for seed in 0..5 {
            assert!(is_one_scene(&pairs(seed, 80, 50, 0.0, 1.0)), "at rest, or turned");
            assert!(is_one_scene(&pairs(seed, 80, 50, 0.5, 1.0)), "moved");
            assert!(is_one_scene(&pairs(seed, 80, 40, 0.5, 0.0)), "moved before a plane");
            assert!(is_one_scene(&pairs(seed, 30, 28, 0.5, 1.0)), "few pairs");
        }
    }

    /// Without the geometry, all of these would count as one scene.
    #[test]
    fn chance_matches_are_no_scene() {
        for count in [20, 45] {
            let wrong = (0..40).filter(|seed| is_one_scene(&pairs(*seed, count, 0, 0.0, 0.0))).count();
            assert!(wrong == 0, "{wrong} of 40 with {count} pairs");
        }
        assert!(!is_one_scene(&[]));
        let one = DirectionPair { layout: Vector3::z(), camera: -Vector3::z() };
        assert!(!is_one_scene(&pairs(1, 14, 14, 0.0, 0.0)), "too few");
        let _ = is_one_scene(&[one; 40]);
    }
}
