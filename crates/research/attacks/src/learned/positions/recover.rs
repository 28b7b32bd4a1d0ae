//! The attack: posterior position of each keypoint of an obfuscated image.

use crate::{AttackError, DecodedDescriptors, Observation};
use rayon::prelude::*;
use veiloc_geometry::Pixel;

use super::bins::Bins;
use super::{PositionNetwork, fits};

/// Bins per row: finer than in training, so that positions between training bins are resolved.
const BINS: usize = 160;

/// Estimated position of a keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionEstimate {
    /// The position with the smallest expected distance to the keypoint; on one line, the median.
    pub pixel: Pixel,
    /// Expected distance between keypoint and `pixel`, pixels.
    pub expected_error: f64,
    /// The expected position; for an untrained network, the prior-only baseline.
    pub mean: Pixel,
}

/// Recovers the position of each keypoint, `[N]`, from all that was sent of an image of `width` by `height` pixels.
///
/// # Errors
/// [`AttackError::DescriptorCount`] when the numbers of descriptors and observations differ,
/// [`AttackError::Dimensions`] when the descriptors have another dimension than the network's,
/// [`AttackError::Scheme`] when a row was not sent under the network's scheme, [`AttackError::Features`] when the
/// network cannot run.
pub fn recover(
    network: &PositionNetwork,
    observations: &[Observation],
    descriptors: &DecodedDescriptors,
    width: u32,
    height: u32,
) -> Result<Vec<PositionEstimate>, AttackError> {
    if descriptors.len() != observations.len() {
        let (keypoints, descriptors) = (observations.len(), descriptors.len());
        return Err(AttackError::DescriptorCount { keypoints, descriptors });
    }
    if observations.is_empty() {
        return Ok(Vec::new());
    }
    network.network.check_dimension(descriptors)?;
    if let Some(row) = observations.iter().position(|o| !fits(network.scheme, o)) {
        return Err(AttackError::Scheme {
            found: format!("row {row} was not sent under {}", network.scheme),
            expected: "the network was trained for this scheme only".to_owned(),
        });
    }
    let size = [width, height];
    let bins = Bins::of(observations, size, BINS);
    Ok(estimates(&bins, &network.shares(descriptors, &bins, size)?))
}

/// The estimates of an untrained network.
pub(super) fn of_prior(observations: &[Observation], size: [u32; 2]) -> Vec<PositionEstimate> {
    let bins = Bins::of(observations, size, BINS);
    let shares: Vec<f32> = bins.log_prior.iter().map(|g| g.exp()).collect();
    estimates(&bins, &shares)
}

fn estimates(bins: &Bins, shares: &[f32]) -> Vec<PositionEstimate> {
    let estimate = |row: usize| {
        let own = bins.of_row(row);
        best(&bins.positions[own.clone()], &shares[own])
    };
    (0..bins.rows()).into_par_iter().map(estimate).collect()
}

/// Estimate from positions with these probabilities.
fn best(positions: &[Pixel], shares: &[f32]) -> PositionEstimate {
    let (mut u, mut v, mut whole) = (0.0, 0.0, 0.0);
    for (position, share) in positions.iter().zip(shares) {
        let share = f64::from(*share);
        (u, v, whole) = (u + share * position.u, v + share * position.v, whole + share);
    }
    let error = |from: &Pixel| {
        let far = positions.iter().zip(shares).map(|(p, share)| f64::from(*share) * p.distance(from));
        far.sum::<f64>() / whole
    };
    let errors = positions.iter().map(|p| (error(p), *p));
    let (expected_error, pixel) =
        errors.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, Pixel::new(f64::NAN, f64::NAN)));
    PositionEstimate { pixel, expected_error, mean: Pixel::new(u / whole, v / whole) }
}
