//! What is wrong with an image, for a person who gave several.

use crate::output::items::{Fault, FaultKind};
use veiloc_features::FeatureError;
use veiloc_obfuscation::ExtractError;

/// What is wrong with an image that nothing could be extracted from.
pub(crate) fn fault_of(error: &ExtractError) -> Fault {
    let kind = match error {
        ExtractError::Image(FeatureError::ImageSize { .. } | FeatureError::MaskSize { .. })
        | ExtractError::Profile(_) => FaultKind::Unfit,
        _ => FaultKind::Damaged,
    };
    Fault::new(kind, error)
}
