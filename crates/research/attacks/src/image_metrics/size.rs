//! Size check: only images of equal size can be compared.

use veiloc_features::ColourImage;

use crate::AttackError;

/// Width and height of both images.
///
/// # Errors
/// [`AttackError::Sizes`].
pub(crate) fn one_size(a: &ColourImage, b: &ColourImage) -> Result<[usize; 2], AttackError> {
    let [own, other] = [a, b].map(|image| [image.width(), image.height()]);
    if own != other {
        return Err(AttackError::Sizes { sizes: [own, other] });
    }
    Ok(own.map(|side| side as usize))
}
