//! Feature extraction of a query, with an optional mask.

use std::path::Path;

use veiloc_features::{Features, load_mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{SealOptions, extract, extract_masked};
use veiloc_protocol::Profile;

use crate::error::EvalError;

/// Features of an image as a device extracts them, with their camera.
///
/// # Errors
/// [`EvalError`] when the image or its mask cannot be used.
pub(crate) fn extract_features(
    image: &Path,
    mask: Option<&Path>,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), EvalError> {
    Ok(match mask {
        Some(mask) => {
            let mask = load_mask(mask)?;
            extract_masked(image, &mask, camera, profile, options)?
        }
        None => extract(image, camera, profile, options)?,
    })
}
