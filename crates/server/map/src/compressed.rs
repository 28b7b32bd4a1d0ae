//! Data that a compressed map keeps about the whole map it was made from.
//!
//! A compressed map keeps a part of the points, and a few observing keypoints of each, with their descriptors. The
//! number of observing images and the covariance of each point are stored as in the whole map, so that a match has the
//! same likelihood as in the whole map.

use veiloc_geometry::nalgebra::Matrix3;

/// Summary of a point in the whole map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointSummary {
    /// Number of images that observe it.
    pub seen_by: u32,
    /// Covariance of its position, map units squared: `xx, xy, xz, yy, yz, zz`.
    pub covariance: [f32; 6],
}

impl PointSummary {
    /// From a finite, positive definite covariance, rounded to the stored precision.
    pub fn new(seen_by: u32, covariance: &[[f64; 3]; 3]) -> Self {
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = covariance;
        // The rounded matrix must stay positive definite: the diagonal is enlarged by more than the rounding error.
        let grown = |v: &f64| (v * (1.0 + GROWTH)).min(LARGEST) as f32;
        let rounded = |v: &f64| v.clamp(-LARGEST, LARGEST) as f32;
        let stored = Self {
            seen_by,
            covariance: [grown(xx), rounded(xy), rounded(xz), grown(yy), rounded(yz), grown(zz)],
        };
        if stored.is_covariance() {
            return stored;
        }
        // Too thin for the stored precision: use the largest variance in all directions.
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

/// Data about the whole map from which a map was compressed.
#[derive(Debug, Clone, PartialEq)]
pub struct WholeMapSummary {
    /// Length of the file of the whole map, bytes.
    pub bytes: u64,
    /// Keypoints of the whole map.
    pub keypoints: u64,
    /// Points of the whole map.
    pub points: u64,
    /// `[P]`, summaries of the stored points.
    pub of_points: Vec<PointSummary>,
    /// Origin of positions, map units, if the file is packed; see [`MapModel::pack`](crate::MapModel::pack).
    pub packed_from: Option<[f64; 3]>,
}

impl WholeMapSummary {
    /// Checks the data against the track lengths of the map.
    pub(crate) fn check(&self, track_lengths: impl ExactSizeIterator<Item = usize>) -> Result<(), String> {
        if self.of_points.len() != track_lengths.len() {
            return Err(format!(
                "has summaries of {} points, but the map has {}",
                self.of_points.len(),
                track_lengths.len()
            ));
        }
        if self.points < self.of_points.len() as u64 {
            return Err("has fewer points of the whole map than stored points".to_owned());
        }
        for (id, (of, stored)) in self.of_points.iter().zip(track_lengths).enumerate() {
            if (of.seen_by as usize) < stored {
                return Err(format!("has fewer observing images of point {id} than observations"));
            }
            if !of.is_covariance() {
                return Err(format!("has no valid covariance of point {id}"));
            }
        }
        Ok(())
    }
}

/// Relative enlargement of the diagonal before rounding.
const GROWTH: f64 = 1e-5;
/// Largest stored variance, map units squared.
const LARGEST: f64 = 1e30;
/// Smallest stored variance, map units squared.
const SMALLEST: f64 = 1e-30;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_covariance_is_close_and_positive_definite() {
        // A point with little parallax: a thousand times as uncertain along the rays as across.
        let along = [0.6, 0.0, 0.8];
        let thin: [[f64; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| along[i] * along[j] * 1.0 + if i == j { 1e-6 } else { 0.0 })
        });
        let stored = PointSummary::new(5, &thin);
        for (a, b) in stored.covariance().iter().flatten().zip(thin.iter().flatten()) {
            assert!((a - b).abs() <= 2e-5, "{a} {b}");
        }
        for c in [1e-40, 1e-12, 1.0, 1e20, 1e200] {
            let flat = [[c, 0.0, 0.0], [0.0, c, 0.0], [0.0, 0.0, c]];
            assert!(PointSummary::new(1, &flat).is_covariance(), "{c}");
            // Without any thickness: widened, never refused and never NaN.
            let needle = [[c, c, c], [c, c, c], [c, c, c]];
            assert!(PointSummary::new(1, &needle).is_covariance(), "{c}");
        }
    }

    #[test]
    fn inconsistent_data_is_named() {
        let round = PointSummary { seen_by: 3, covariance: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        let of = |of_points: Vec<PointSummary>| WholeMapSummary {
            bytes: 9,
            keypoints: 9,
            points: 2,
            of_points,
            packed_from: None,
        };
        assert_eq!(of(vec![round, round]).check([3, 2].into_iter()), Ok(()));
        let refused =
            |of_points, lengths: Vec<usize>| of(of_points).check(lengths.into_iter()).expect_err("refused");
        assert!(refused(vec![round], vec![3, 3]).contains("summaries of 1 points"));
        assert!(refused(vec![round, round], vec![3, 4]).contains("point 1"));
        assert!(refused(vec![round; 3], vec![1; 3]).contains("fewer points"));
        for wrong in [
            [f32::NAN, 0.0, 0.0, 1.0, 0.0, 1.0],
            [0.0; 6],
            [1.0, 2.0, 0.0, 1.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0, -1.0, 0.0, -1.0],
        ] {
            let stored = PointSummary { seen_by: 3, covariance: wrong };
            assert!(refused(vec![stored, round], vec![3, 3]).contains("covariance of point 0"), "{wrong:?}");
        }
    }
}
