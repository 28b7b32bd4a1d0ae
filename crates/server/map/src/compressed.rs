//! What a compressed map remembers of the whole one that it was made of.
//!
//! A compressed map keeps a part of the points, and of each a few of the keypoints that see it, with their descriptors. What
//! the keypoints that are gone told of a point (how many images see it, how exactly they hold it) is kept as numbers, so
//! that matches with it are believed as much as in the whole map, and no more.

use veiloc_geometry::nalgebra::Matrix3;

/// What the whole map knew of one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Remembered {
    /// Number of images that see it.
    pub seen_by: u32,
    /// Covariance of its position, map units squared: `xx, xy, xz, yy, yz, zz`.
    pub covariance: [f32; 6],
}

impl Remembered {
    /// Of a covariance that is finite and positive definite; rounded to what is kept.
    pub fn new(seen_by: u32, covariance: &[[f64; 3]; 3]) -> Self {
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = covariance;
        // The rounding must leave a covariance: the diagonal grows by more than the rounding takes.
        let grown = |v: &f64| (v * (1.0 + GROWTH)).min(LARGEST) as f32;
        let rounded = |v: &f64| v.clamp(-LARGEST, LARGEST) as f32;
        let kept = Self {
            seen_by,
            covariance: [grown(xx), rounded(xy), rounded(xz), grown(yy), rounded(yz), grown(zz)],
        };
        if kept.is_covariance() {
            return kept;
        }
        // Thinner than the numbers that are kept can tell: as wide in each direction as in the widest.
        let widest = (xx + yy + zz).clamp(SMALLEST, LARGEST) as f32;
        Self { seen_by, covariance: [widest, 0.0, 0.0, widest, 0.0, widest] }
    }

    /// As a matrix.
    pub fn covariance(&self) -> [[f64; 3]; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.covariance.map(f64::from);
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    /// Finite and positive definite.
    pub(crate) fn is_covariance(&self) -> bool {
        let c = self.covariance();
        let m = Matrix3::from_fn(|i, j| c[i][j]);
        let scale = m.diagonal().max();
        scale > 0.0 && m.iter().all(|v| v.is_finite()) && (m / scale).cholesky().is_some()
    }
}

/// What a map was compressed from, and what is remembered of each of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Compressed {
    /// Bytes of the whole map's file.
    pub bytes: u64,
    /// Keypoints of the whole map.
    pub keypoints: u64,
    /// Points of the whole map.
    pub points: u64,
    /// `[P]`, of the points that were kept.
    pub of_points: Vec<Remembered>,
    /// Where positions are counted from, map units, when the file is packed; see [`MapModel::pack`](crate::MapModel::pack).
    pub packed_from: Option<[f64; 3]>,
}

impl Compressed {
    /// Whether it can be of a map whose points have these numbers of observations.
    pub(crate) fn check(&self, track_lengths: impl ExactSizeIterator<Item = usize>) -> Result<(), String> {
        if self.of_points.len() != track_lengths.len() {
            return Err(format!(
                "remembers {} points, and the map has {}",
                self.of_points.len(),
                track_lengths.len()
            ));
        }
        if self.points < self.of_points.len() as u64 {
            return Err("remembers fewer points of the whole map than were kept".to_owned());
        }
        for (id, (of, kept)) in self.of_points.iter().zip(track_lengths).enumerate() {
            if (of.seen_by as usize) < kept {
                return Err(format!("says that fewer images saw point {id} than do"));
            }
            if !of.is_covariance() {
                return Err(format!("has no covariance of point {id}"));
            }
        }
        Ok(())
    }
}

/// What the diagonal of a covariance grows by, that rounding leaves a covariance.
const GROWTH: f64 = 1e-5;
/// Beyond this no variance is told from any other, map units squared.
const LARGEST: f64 = 1e30;
/// And below this.
const SMALLEST: f64 = 1e-30;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_a_covariance_near_the_one_given() {
        // A point seen under a small angle: a thousand times as uncertain along the rays as across.
        let along = [0.6, 0.0, 0.8];
        let thin: [[f64; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| along[i] * along[j] * 1.0 + if i == j { 1e-6 } else { 0.0 })
        });
        let kept = Remembered::new(5, &thin);
        for (a, b) in kept.covariance().iter().flatten().zip(thin.iter().flatten()) {
            assert!((a - b).abs() <= 2e-5, "{a} {b}");
        }
        for c in [1e-40, 1e-12, 1.0, 1e20, 1e200] {
            let flat = [[c, 0.0, 0.0], [0.0, c, 0.0], [0.0, 0.0, c]];
            assert!(Remembered::new(1, &flat).is_covariance(), "{c}");
            // Of no thickness at all: widened, never refused and never NaN.
            let needle = [[c, c, c], [c, c, c], [c, c, c]];
            assert!(Remembered::new(1, &needle).is_covariance(), "{c}");
        }
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let round = Remembered { seen_by: 3, covariance: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        let of = |of_points: Vec<Remembered>| Compressed {
            bytes: 9,
            keypoints: 9,
            points: 2,
            of_points,
            packed_from: None,
        };
        assert_eq!(of(vec![round, round]).check([3, 2].into_iter()), Ok(()));
        let refused =
            |of_points, lengths: Vec<usize>| of(of_points).check(lengths.into_iter()).expect_err("refused");
        assert!(refused(vec![round], vec![3, 3]).contains("remembers 1 points"));
        assert!(refused(vec![round, round], vec![3, 4]).contains("point 1"));
        assert!(refused(vec![round; 3], vec![1; 3]).contains("fewer points"));
        for wrong in [
            [f32::NAN, 0.0, 0.0, 1.0, 0.0, 1.0],
            [0.0; 6],
            [1.0, 2.0, 0.0, 1.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0, -1.0, 0.0, -1.0],
        ] {
            let kept = Remembered { seen_by: 3, covariance: wrong };
            assert!(refused(vec![kept, round], vec![3, 3]).contains("covariance of point 0"), "{wrong:?}");
        }
    }
}
