//! Accuracy of a position network on images with known keypoints: information in bits, and pixels beside the
//! prior-only baseline.

use rand_chacha::ChaCha8Rng;
use veiloc_geometry::Pixel;
use veiloc_obfuscation::audit::obfuscate_points;
use veiloc_protocol::AngleBits;

use crate::{
    AttackError, ErrorSummary, KnownImage, Observation, bits_over_prior, errors_px, prior_median, prior_only,
};

use super::bins::Bins;
use super::{PositionNetwork, recover};

/// Number of bins in which information is measured.
const BINS: usize = 64;

/// Accuracy of a position network on a set of images.
#[derive(Debug, Clone, PartialEq)]
pub struct PositionAccuracy {
    /// Number of keypoints.
    pub keypoints: usize,
    /// Mean over keypoints of `log2(p / p₀)` for the bin that holds the keypoint: `p` is the network's probability,
    /// `p₀` that of the prior-only baseline. 0 for the baseline.
    pub information: f64,
    /// Errors of [`PositionEstimate::pixel`](super::PositionEstimate::pixel), pixels.
    pub errors: ErrorSummary,
    /// Errors of the prior-only baseline, pixels.
    pub prior: ErrorSummary,
    /// [`bits_over_prior`] of [`Self::errors`].
    pub bits: f64,
    /// [`bits_over_prior`] of [`PositionEstimate::mean`](super::PositionEstimate::mean).
    pub bits_of_mean: f64,
    /// [`bits_over_prior`] of the posterior median of an untrained network: what the same answer is worth without
    /// content.
    pub bits_untrained: f64,
    /// [`Self::information`] of each image.
    pub by_image: Vec<f64>,
}

/// Accuracy of a network on these images, each obfuscated under the network's scheme with this generator; `None` if
/// no keypoint lies in its image.
///
/// # Errors
/// As [`recover()`](super::recover()), and [`AttackError::Seal`] when an image cannot be obfuscated.
pub fn position_accuracy(
    network: &PositionNetwork,
    images: &[KnownImage],
    angle_bits: AngleBits,
    rng: &mut ChaCha8Rng,
) -> Result<Option<PositionAccuracy>, AttackError> {
    let (mut errors, mut prior_errors) = (Vec::new(), Vec::new());
    let (mut gain, mut gain_rows) = (0.0, 0);
    let (mut bits, mut of_mean, mut untrained, mut by_image) = (0.0, 0.0, 0.0, Vec::new());
    for image in images {
        let size @ [width, height] = image.size();
        let inside =
            |p: &Pixel| (0.0..f64::from(width)).contains(&p.u) && (0.0..f64::from(height)).contains(&p.v);
        let inside: Vec<usize> =
            (0..image.keypoints().len()).filter(|i| inside(&image.keypoints()[*i])).collect();
        if inside.is_empty() {
            continue;
        }
        let truth: Vec<Pixel> = inside.iter().map(|i| image.keypoints()[*i]).collect();
        let descriptors = image.descriptors().select(&inside);
        let sent = obfuscate_points(&truth, width, height, &network.scheme(), angle_bits, rng)?;
        let sent = Observation::of_sent(&sent);

        let bins = Bins::of(&sent, size, BINS);
        let shares = network.shares(&descriptors, &bins, size)?;
        let held: Vec<usize> =
            truth.iter().enumerate().filter_map(|(row, position)| bins.bin_of(row, *position)).collect();
        let own = information(&shares, &bins, &held);
        (gain, gain_rows) = (gain + own, gain_rows + held.len());
        by_image.push(own / (held.len() as f64).max(1.0));

        let found = recover(network, &sent, &descriptors, width, height)?;
        let error = errors_px(found.iter().map(|e| e.pixel), &truth);
        let mean = errors_px(found.iter().map(|e| e.mean), &truth);
        let before = errors_px(recover::of_prior(&sent, size).iter().map(|e| e.pixel), &truth);
        let prior = errors_px(prior_only(&sent, width, height), &truth);
        let rows = error.len() as f64;
        bits += rows * bits_over_prior(&error, &prior, width, height);
        untrained += rows * bits_over_prior(&before, &prior, width, height);
        of_mean += rows * bits_over_prior(&mean, &prior, width, height);
        errors.extend(error);
        prior_errors.extend(errors_px(prior_median(&sent, width, height), &truth));
    }
    let keypoints = errors.len();
    Ok((keypoints > 0).then(|| PositionAccuracy {
        keypoints,
        information: if gain_rows > 0 { gain / gain_rows as f64 } else { 0.0 },
        errors: ErrorSummary::of(&errors),
        prior: ErrorSummary::of(&prior_errors),
        bits: bits / keypoints as f64,
        bits_of_mean: of_mean / keypoints as f64,
        bits_untrained: untrained / keypoints as f64,
        by_image,
    }))
}

/// Sum of `log2` of the share over the baseline's share, over the bins that hold keypoints.
fn information(shares: &[f32], bins: &Bins, held: &[usize]) -> f64 {
    let of_bin = |bin: &usize| {
        let log_posterior = f64::from(shares[*bin]).max(f64::from(f32::MIN_POSITIVE)).ln();
        (log_posterior - f64::from(bins.log_prior[*bin])) / std::f64::consts::LN_2
    };
    held.iter().map(of_bin).sum()
}
