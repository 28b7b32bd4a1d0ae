//! The flow from a map image to the query, estimated from keypoints with known positions in both.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};

use crate::metrics::median;

/// A keypoint of the map image, and its position in the query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FlowVector {
    /// Position in the map image, scaled to the query's size, pixels.
    pub(super) from: Vector2<f64>,
    /// Query position minus `from`, pixels.
    pub(super) moved: Vector2<f64>,
}

/// Predicted position in the query of a point of the map image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WarpedPoint {
    pub(super) pixel: Pixel,
    /// Standard deviation of that position per axis, pixels.
    pub(super) sigma: f64,
}

/// A smooth flow estimated from vectors with outliers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Flow {
    vectors: Vec<FlowVector>,
}

/// Number of neighbouring vectors in an estimate.
const AROUND: usize = 12;
/// A vector is an outlier when its distance to the median of its neighbours exceeds this multiple of the usual
/// distance.
const OUTLIER: f64 = 3.0;
/// Minimum number of vectors of a flow.
const MIN_KEYPOINTS: usize = 8;
/// Distances below this many pixels have equal weight.
const REACH: f64 = 15.0;
/// Change of the flow per pixel of distance from the nearest vector that the affine fit does not explain.
const DRIFT: f64 = 0.1;
/// Standard deviation of a re-detected keypoint, pixels.
const DETECTOR: f64 = 1.5;

impl Flow {
    /// The flow of these vectors without outliers; `None` when too few are left.
    pub(super) fn new(vectors: Vec<FlowVector>) -> Option<Self> {
        let all = Self { vectors };
        let agrees = |v: &FlowVector| {
            // The vector itself is among them, but it does not change a median of twelve.
            let near = all.nearest(v.from);
            let middle = median_vector(near.iter().map(|v| v.moved));
            let spread = median(near.iter().map(|v| (v.moved - middle).norm()).collect());
            (v.moved - middle).norm() <= OUTLIER * spread.max(DETECTOR)
        };
        let kept: Vec<FlowVector> = all.vectors.iter().filter(|v| agrees(v)).copied().collect();
        (kept.len() >= MIN_KEYPOINTS).then_some(Self { vectors: kept })
    }

    /// Position in the query of a point of the map image: a locally weighted affine fit with soft rejection of
    /// outliers.
    pub(super) fn warp(&self, point: Pixel) -> WarpedPoint {
        let at = point.vector();
        let near = self.nearest(at);
        let nearness: Vec<f64> =
            near.iter().map(|v| 1.0 / ((v.from - at).norm_squared() + REACH * REACH)).collect();
        let mut trust = vec![1.0; near.len()];
        let (mut moved, mut spread) = (Vector2::zeros(), 0.0);
        for _ in 0..4 {
            let weights: Vec<f64> = nearness.iter().zip(&trust).map(|(n, t)| n * t).collect();
            let fit = AffineFit::of(&near, &weights, at);
            moved = fit.at_origin();
            let misfit: Vec<f64> = near.iter().map(|v| (v.moved - fit.at(v.from - at)).norm()).collect();
            spread = median(misfit.clone()).max(DETECTOR);
            trust = misfit.iter().map(|m| 1.0 / (1.0 + (m / spread).powi(2))).collect();
        }
        let gap = near.first().map_or(0.0, |v| (v.from - at).norm());
        let sigma = spread.hypot(DRIFT * gap);
        WarpedPoint { pixel: Pixel::new(at.x + moved.x, at.y + moved.y), sigma }
    }

    /// The vectors around a point, nearest first; ties keep the given order.
    fn nearest(&self, at: Vector2<f64>) -> Vec<FlowVector> {
        let mut all: Vec<(f64, usize)> =
            self.vectors.iter().enumerate().map(|(i, v)| ((v.from - at).norm_squared(), i)).collect();
        let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if all.len() > AROUND {
            all.select_nth_unstable_by(AROUND - 1, order);
            all.truncate(AROUND);
        }
        all.sort_unstable_by(order);
        all.into_iter().map(|(_, i)| self.vectors[i]).collect()
    }
}

/// `moved ≈ M (1, x, y)` around a point, by weighted least squares.
struct AffineFit {
    rows: [Vector3<f64>; 2],
}

impl AffineFit {
    fn of(vectors: &[FlowVector], weights: &[f64], at: Vector2<f64>) -> Self {
        let mut normal = Matrix3::zeros();
        let mut right = [Vector3::zeros(); 2];
        for (v, w) in vectors.iter().zip(weights) {
            let d = v.from - at;
            let row = Vector3::new(1.0, d.x, d.y);
            normal += *w * row * row.transpose();
            right[0] += *w * v.moved.x * row;
            right[1] += *w * v.moved.y * row;
        }
        // Changes of a tenth of a pixel per pixel are common; the ridge keeps the fit stable for collinear vectors.
        let ridge = weights.iter().sum::<f64>() * (DETECTOR / DRIFT).powi(2) / vectors.len().max(1) as f64;
        normal[(1, 1)] += ridge;
        normal[(2, 2)] += ridge;
        let inverse = normal.try_inverse().unwrap_or_else(Matrix3::zeros);
        Self { rows: right.map(|r| inverse * r) }
    }

    fn at_origin(&self) -> Vector2<f64> {
        Vector2::new(self.rows[0].x, self.rows[1].x)
    }

    fn at(&self, d: Vector2<f64>) -> Vector2<f64> {
        let row = Vector3::new(1.0, d.x, d.y);
        Vector2::new(self.rows[0].dot(&row), self.rows[1].dot(&row))
    }
}

fn median_vector(vectors: impl Iterator<Item = Vector2<f64>> + Clone) -> Vector2<f64> {
    Vector2::new(median(vectors.clone().map(|v| v.x).collect()), median(vectors.map(|v| v.y).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The image rotated, scaled and moved slightly.
    fn true_flow(at: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(12.0 + 0.05 * at.x - 0.03 * at.y, -7.0 + 0.03 * at.x + 0.05 * at.y)
    }

    #[test]
    fn affine_flow_is_robust_to_outliers() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut draw = || Vector2::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        let vectors: Vec<FlowVector> = (0..300)
            .map(|i| {
                let from = draw();
                let moved = if i % 5 == 0 { draw() - from } else { true_flow(from) };
                FlowVector { from, moved }
            })
            .collect();
        let flow = Flow::new(vectors).expect("enough vectors");
        assert!(flow.vectors.iter().filter(|v| (v.moved - true_flow(v.from)).norm() > 20.0).count() < 6);
        let mut errors = Vec::new();
        for _ in 0..200 {
            let at = draw();
            let warped = flow.warp(Pixel::new(at.x, at.y));
            errors.push((warped.pixel.vector() - at - true_flow(at)).norm());
        }
        assert!(median(errors.clone()) < 1.0, "{}", median(errors));
    }

    #[test]
    fn too_few_vectors_give_no_flow_and_coincident_vectors_no_panic() {
        let one = FlowVector { from: Vector2::new(5.0, 5.0), moved: Vector2::new(1.0, 0.0) };
        assert_eq!(Flow::new(vec![one; MIN_KEYPOINTS - 1]), None);
        let warped = Flow::new(vec![one; MIN_KEYPOINTS]).expect("enough").warp(Pixel::new(300.0, 5.0));
        assert!((warped.pixel.u - 301.0).abs() < 1e-6 && warped.sigma > 20.0, "{warped:?}");
    }
}
