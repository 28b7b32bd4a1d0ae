//! Maps extraction errors to the error kinds that batch commands report per image.

use crate::output::items::{Fault, FaultKind};
use veiloc_features::FeatureError;
use veiloc_obfuscation::SealError;

/// Classifies an error of feature extraction.
pub(crate) fn fault_of(error: &SealError) -> Fault {
    let kind = match error {
        SealError::Image(FeatureError::ImageSize { .. } | FeatureError::MaskSize { .. }) => FaultKind::Unfit,
        SealError::Image(_) => FaultKind::Damaged,
        // The profile requests more than this device provides.
        _ => FaultKind::Unfit,
    };
    Fault::new(kind, error)
}
