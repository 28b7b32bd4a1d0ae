//! Maps extraction errors to the error kinds that batch commands report per image.

use crate::output::items::{InputError, InputErrorKind};
use veiloc_features::FeatureError;
use veiloc_obfuscation::SealError;

/// Classifies an error of feature extraction.
pub(crate) fn extraction_error(error: &SealError) -> InputError {
    let kind = match error {
        SealError::Image(FeatureError::ImageSize { .. } | FeatureError::MaskSize { .. }) => {
            InputErrorKind::Unfit
        }
        SealError::Image(_) => InputErrorKind::Damaged,
        // The profile requests more than this device provides.
        _ => InputErrorKind::Unfit,
    };
    InputError::new(kind, error)
}
