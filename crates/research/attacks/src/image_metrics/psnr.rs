//! Peak signal-to-noise ratio.

use crate::AttackError;
use crate::image_metrics::size::one_size;
use veiloc_features::ColourImage;

/// `10 log10 (255² / mean squared difference)` over all pixels and colours, decibels; infinite for equal images.
///
/// # Errors
/// [`AttackError::Sizes`].
pub fn psnr(a: &ColourImage, b: &ColourImage) -> Result<f64, AttackError> {
    one_size(a, b)?;
    let square = |(x, y): (&u8, &u8)| u64::from(x.abs_diff(*y)).pow(2);
    let sum: u64 = a.data().iter().zip(b.data()).map(square).sum();
    Ok(10.0 * (255.0 * 255.0 * a.data().len() as f64 / sum as f64).log10())
}
