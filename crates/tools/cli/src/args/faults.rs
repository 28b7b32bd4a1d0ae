//! What is wrong with an image, for a person who gave several.

use crate::output::items::{Fault, FaultKind};
use veiloc_features::FeatureError;
use veiloc_obfuscation::SealError;

/// What is wrong with an image that nothing could be extracted from.
pub(crate) fn fault_of(error: &SealError) -> Fault {
    let kind = match error {
        SealError::Image(FeatureError::ImageSize { .. } | FeatureError::MaskSize { .. }) => FaultKind::Unfit,
        SealError::Image(_) => FaultKind::Damaged,
        // The profile asks for more than this device gives.
        _ => FaultKind::Unfit,
    };
    Fault::new(kind, error)
}
