//! Only images of one size are compared.

use veiloc_features::ColourImage;

use crate::image_metrics::error::JudgeError;

/// Width and height of both images.
///
/// # Errors
/// [`JudgeError::Sizes`].
pub(crate) fn one_size(a: &ColourImage, b: &ColourImage) -> Result<[usize; 2], JudgeError> {
    let [own, other] = [a, b].map(|image| [image.width(), image.height()]);
    if own != other {
        return Err(JudgeError::Sizes { sizes: [own, other] });
    }
    Ok(own.map(|side| side as usize))
}
