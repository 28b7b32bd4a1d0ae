//! The attack: where the network puts each keypoint of an obfuscated image.

use crate::{AttackError, Descriptors, Observation};
use rayon::prelude::*;
use veiloc_geometry::Pixel;

use super::bins::Bins;
use super::{PositionNetwork, fits};

/// Bins of a row: finer than the networks learn with, so that places between them are told apart.
const BINS: usize = 160;

/// Where a keypoint is said to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The place along the candidates from which the keypoint is expected to be least far: of one line, the median.
    pub pixel: Pixel,
    /// How far it is expected to be from there, pixels.
    pub expected_error: f64,
    /// The expected place; of a network that has learned nothing, the guess.
    pub mean: Pixel,
}

/// Where the network puts each keypoint, `[N]`, from all that was sent of an image of `width` by `height` pixels.
///
/// # Errors
/// an [`AttackError`] when there is not one descriptor for each observation, or they are of another dimension than
/// those learned from, [`AttackError::Scheme`] when a row was not sent under the network's scheme,
/// [`AttackError::Features`] when the network cannot run.
pub fn recover(
    network: &PositionNetwork,
    observations: &[Observation],
    descriptors: &Descriptors,
    width: u32,
    height: u32,
) -> Result<Vec<Estimate>, AttackError> {
    if descriptors.len() != observations.len() {
        let (keypoints, descriptors) = (observations.len(), descriptors.len());
        return Err(AttackError::DescriptorCount { keypoints, descriptors });
    }
    if observations.is_empty() {
        return Ok(Vec::new());
    }
    network.network.fits(descriptors)?;
    if let Some(row) = observations.iter().position(|o| !fits(network.scheme, o)) {
        return Err(AttackError::Scheme {
            found: format!("row {row} was not sent under {}", network.scheme),
            expected: "the network learned nothing else".to_owned(),
        });
    }
    let size = [width, height];
    let bins = Bins::of(observations, size, BINS);
    Ok(estimates(&bins, &network.shares(descriptors, &bins, size)?))
}

/// What a network that has learned nothing would say.
pub(super) fn of_guess(observations: &[Observation], size: [u32; 2]) -> Vec<Estimate> {
    let bins = Bins::of(observations, size, BINS);
    let shares: Vec<f32> = bins.guess.iter().map(|g| g.exp()).collect();
    estimates(&bins, &shares)
}

fn estimates(bins: &Bins, shares: &[f32]) -> Vec<Estimate> {
    let estimate = |row: usize| {
        let own = bins.of_row(row);
        best(&bins.places[own.clone()], &shares[own])
    };
    (0..bins.rows()).into_par_iter().map(estimate).collect()
}

/// Of places that are as likely as their shares say.
fn best(places: &[Pixel], shares: &[f32]) -> Estimate {
    let (mut u, mut v, mut whole) = (0.0, 0.0, 0.0);
    for (place, share) in places.iter().zip(shares) {
        let share = f64::from(*share);
        (u, v, whole) = (u + share * place.u, v + share * place.v, whole + share);
    }
    let error = |from: &Pixel| {
        let far = places.iter().zip(shares).map(|(p, share)| f64::from(*share) * p.distance(from));
        far.sum::<f64>() / whole
    };
    let errors = places.iter().map(|p| (error(p), *p));
    let (expected_error, pixel) =
        errors.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, Pixel::new(f64::NAN, f64::NAN)));
    Estimate { pixel, expected_error, mean: Pixel::new(u / whole, v / whole) }
}
