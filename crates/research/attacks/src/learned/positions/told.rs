//! What a network tells of images whose keypoints are known: in bits, and in pixels beside the guess.

use crate::AttackError;
use crate::{ErrorSummary, KnownImage, bits_over_prior, errors_px, prior_only};
use rand_chacha::ChaCha8Rng;

use super::bins::Bins;
use super::lessons::Lesson;
use super::{PositionNetwork, PositionTask, recover};

/// Bins in which information is measured.
const BINS: usize = 64;

/// What a network tells of some images.
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    /// Keypoints.
    pub keypoints: usize,
    /// Mean over keypoints of `log2` of how likely the network finds the bin in which the keypoint is, over how likely the
    /// guess finds it: 0 for the guess.
    pub information: f64,
    /// Errors of [`Estimate::pixel`](super::Estimate::pixel), pixels.
    pub errors: ErrorSummary,
    /// Errors of the guess.
    pub guess: ErrorSummary,
    /// [`bits_over_prior`] of these errors.
    pub bits: f64,
    /// The same of [`Estimate::mean`](super::Estimate::mean).
    pub bits_of_mean: f64,
    /// The same of the places of least expected error of a network that has learned nothing: what asking for the median
    /// instead of the mean is worth, which of several stretches is much.
    pub bits_untrained: f64,
    /// [`Self::information`] of each image.
    pub by_image: Vec<f64>,
}

/// What a network tells of these images, each obfuscated by this generator; `None` without a keypoint.
///
/// # Errors
/// As [`recover`], and [`AttackError::Seal`] when an image cannot be obfuscated.
pub fn told(
    network: &PositionNetwork,
    images: &[KnownImage],
    task: &PositionTask,
    rng: &mut ChaCha8Rng,
) -> Result<Option<Told>, AttackError> {
    let (mut errors, mut guesses) = (Vec::new(), Vec::new());
    let (mut told, mut told_rows) = (0.0, 0);
    let (mut bits, mut of_mean, mut untrained, mut by_image) = (0.0, 0.0, 0.0, Vec::new());
    for image in images {
        let Some(lesson) = Lesson::new(image) else { continue };
        let drawn = lesson.whole(task, rng)?;
        let (bins, truth) = drawn.bins(BINS);
        let shares = network.layers.shares(&network.numbers, &drawn.descriptors, &bins, drawn.size);
        let (own, rows) = information(&shares, &bins, &truth);
        (told, told_rows) = (told + own, told_rows + rows);
        by_image.push(own / (rows as f64).max(1.0));

        let [width, height] = drawn.size;
        let found = recover::of_columns(network, &drawn.observations, &drawn.descriptors, drawn.size);
        let error = errors_px(found.iter().map(|e| e.pixel), &drawn.truth);
        let mean = errors_px(found.iter().map(|e| e.mean), &drawn.truth);
        let before = recover::of_guess(&drawn.observations, drawn.size);
        let before = errors_px(before.iter().map(|e| e.pixel), &drawn.truth);
        let guess = errors_px(prior_only(&drawn.observations, width, height), &drawn.truth);
        let rows = error.len() as f64;
        bits += rows * bits_over_prior(&error, &guess, width, height);
        untrained += rows * bits_over_prior(&before, &guess, width, height);
        of_mean += rows * bits_over_prior(&mean, &guess, width, height);
        errors.extend(error);
        guesses.extend(guess);
    }
    let keypoints = errors.len();
    Ok((keypoints > 0).then(|| Told {
        keypoints,
        information: if told_rows > 0 { told / told_rows as f64 } else { 0.0 },
        errors: ErrorSummary::of(&errors),
        guess: ErrorSummary::of(&guesses),
        bits: bits / keypoints as f64,
        bits_of_mean: of_mean / keypoints as f64,
        bits_untrained: untrained / keypoints as f64,
        by_image,
    }))
}

/// Sum over the rows that have a truth of `log2` of its share over the guess's, and how many rows they are.
pub(super) fn information(shares: &[f32], bins: &Bins, truth: &[Option<usize>]) -> (f64, usize) {
    let of_bin = |bin: &usize| {
        let said = f64::from(shares[*bin]).max(f64::from(f32::MIN_POSITIVE)).ln();
        (said - f64::from(bins.guess[*bin])) / std::f64::consts::LN_2
    };
    (truth.iter().flatten().map(of_bin).sum(), truth.iter().flatten().count())
}
