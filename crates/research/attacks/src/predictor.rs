//! Neighbours predicted from descriptors, without positions: a statistic of the co-occurrence of descriptors.
//!
//! The descriptors `x`, `y` of two keypoints of one image, after subtraction of the image's mean, are modelled as
//! jointly normal with equal covariances; for spatial neighbours they are correlated, for other pairs not. In the
//! coordinates of canonical correlation analysis (covariance the identity, cross-covariance diagonal) the logarithm
//! of the likelihood ratio is
//!
//! ```text
//! Σ_c  ρ_c / (1 − ρ_c²) x_c y_c  −  ρ_c² / (2 (1 − ρ_c²)) (x_c² + y_c²)    (+ a constant)
//! ```
//!
//! and the most likely neighbours of a keypoint are those where it is greatest. Everything is in closed form: two
//! second moments of the training images and two eigendecompositions.

use veiloc_geometry::nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::error::AttackError;
use crate::features::{DecodedDescriptors, KnownImage};
use crate::neighbours::NeighbourLists;
use crate::ranking::likeliest_pairs;

/// Number of directions of descriptor space that are used. Twice as many hardly improve the result on held-out
/// images.
const DIRECTIONS: usize = 64;
/// Added to the variances of unit descriptors; avoids a division by zero in directions without variance.
const FLOOR: f64 = 1e-6;
/// Upper bound of correlations, which keeps the ratio finite.
const LARGEST_CORRELATION: f64 = 0.99;

/// Predicts from descriptors alone which keypoints are neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct NeighbourPredictor {
    /// `[dimension, directions]`: canonical coordinates of a descriptor after subtraction of the image's mean.
    canonical: DMatrix<f32>,
    /// `[directions]`: correlation of neighbours along each direction.
    correlations: DVector<f32>,
}

impl NeighbourPredictor {
    /// Fits the statistic to images with known positions: the neighbours of a keypoint are its `k` nearest keypoints.
    ///
    /// # Errors
    /// [`AttackError::NothingToLearn`] when no keypoint has a neighbour, [`AttackError::Dimensions`] when the
    /// descriptors of images have different dimensions.
    pub fn fit(images: &[KnownImage], k: usize) -> Result<Self, AttackError> {
        let dimension = images.first().map_or(0, |p| p.descriptors().columns().nrows());
        let mut covariance = DMatrix::<f64>::zeros(dimension, dimension);
        let mut keypoints = 0.0;
        for image in images {
            let other = image.descriptors().columns().nrows();
            if other != dimension {
                return Err(AttackError::Dimensions { expected: dimension, found: other });
            }
            let x = image.descriptors().centered();
            covariance += (&x * x.transpose()).cast::<f64>();
            keypoints += x.ncols() as f64;
        }
        let whitening = whitening(covariance / f64::max(keypoints, 1.0));

        let directions = whitening.ncols();
        let mut cross = DMatrix::<f64>::zeros(directions, directions);
        let mut pairs = 0.0;
        for image in images {
            let x = whitening.tr_mul(&image.descriptors().centered());
            let near = NeighbourLists::nearest(image.keypoints(), k);
            let mut sums = DMatrix::<f32>::zeros(directions, x.ncols());
            for (i, mut sum) in sums.column_iter_mut().enumerate() {
                for &j in near.of(i) {
                    sum += x.column(j as usize);
                    pairs += 1.0;
                }
            }
            cross += (&x * sums.transpose()).cast::<f64>();
        }
        if pairs == 0.0 {
            return Err(AttackError::NothingToLearn);
        }
        let eigen = SymmetricEigen::new((&cross + cross.transpose()) / (2.0 * pairs));
        let held = |r: f64| r.clamp(-LARGEST_CORRELATION, LARGEST_CORRELATION) as f32;
        Ok(Self {
            canonical: whitening * eigen.eigenvectors.cast::<f32>(),
            correlations: eigen.eigenvalues.map(held),
        })
    }

    /// The `k` likeliest neighbours of each keypoint, likeliest first; ties are ordered by index.
    ///
    /// # Errors
    /// [`AttackError::Dimensions`] when the descriptors have another dimension than the training descriptors.
    pub fn predict(&self, descriptors: &DecodedDescriptors, k: usize) -> Result<NeighbourLists, AttackError> {
        let found = descriptors.columns().nrows();
        if found != self.canonical.nrows() {
            return Err(AttackError::Dimensions { expected: self.canonical.nrows(), found });
        }
        let x = self.canonical.tr_mul(&descriptors.centered());
        let weight = self.correlations.map(|r| r / (1.0 - r * r));
        let mut weighted = x.clone();
        weighted.column_iter_mut().for_each(|mut c| c.component_mul_assign(&weight));
        let own: Vec<f32> = x
            .column_iter()
            .map(|c| {
                let terms = c.iter().zip(&self.correlations);
                terms.map(|(x, r)| r * r / (2.0 * (1.0 - r * r)) * x * x).sum()
            })
            .collect();
        NeighbourLists::from_lists(&likeliest_pairs(&x, &weighted, &own, k))
    }
}

/// `[dimension, directions]`: the principal directions, divided by the deviation along each.
fn whitening(covariance: DMatrix<f64>) -> DMatrix<f32> {
    let dimension = covariance.nrows();
    if dimension == 0 {
        return DMatrix::zeros(0, 0);
    }
    let eigen = SymmetricEigen::new(covariance);
    let mut order: Vec<usize> = (0..dimension).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    order.truncate(DIRECTIONS);
    let columns: Vec<DVector<f64>> = order
        .iter()
        .map(|&c| eigen.eigenvectors.column(c) / (eigen.eigenvalues[c].max(0.0) + FLOOR).sqrt())
        .collect();
    DMatrix::from_columns(&columns).cast::<f32>()
}
