//! From an image's file to the sealed query: the one place of this crate that seals.

use std::path::Path;

use veiloc_features::{Features, Mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{SealOptions, device_rng, extract, extract_masked, seal};
use veiloc_protocol::{Profile, SealedQuery};

use crate::ClientError;

/// An image, sealed.
#[derive(Debug)]
pub struct SealedImage {
    /// What may be sent.
    pub query: SealedQuery,
    /// Keypoints found in the image; the query may hold fewer.
    pub keypoints: usize,
}

/// Seals an image, JPEG or PNG, for the map of a profile, with random numbers of the operating system.
///
/// - `camera`: of the image as it is in the file.
/// - `options`: how keypoints are hidden and how many are sent, the device's choice whatever the profile says;
///   `SealOptions::default()` is `dcl`.
///
/// Seal an image once and keep the query until it is answered; two queries of one image give its keypoints away (rule L7).
/// Where a second image of one place may be needed, seal all of them in one [`crate::SessionFile`] or
/// [`Session`](veiloc_obfuscation::Session): anchors of two images sealed here cross in what both show (rule L10).
///
/// # Errors
/// [`ClientError`]: a file that is no image, a camera that is not this image's, too little texture, a profile that asks for
/// more than the device gives.
pub fn seal_image(
    image: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<SealedImage, ClientError> {
    seal_extracted(image, extract(image, camera, profile, options)?, profile, options)
}

/// As [`seal_image`], without what a mask hides: nothing there is looked at, and two images that differ there only give the same
/// query (rule L13). The mask is of the image as it is in the file; [`load_mask`](veiloc_features::load_mask) reads one.
///
/// # Errors
/// As [`seal_image`]; a mask of another size.
pub fn seal_masked(
    image: &Path,
    mask: &Mask,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<SealedImage, ClientError> {
    seal_extracted(image, extract_masked(image, mask, camera, profile, options)?, profile, options)
}

fn seal_extracted(
    image: &Path,
    (features, camera): (Features, Intrinsics),
    profile: &Profile,
    options: &SealOptions,
) -> Result<SealedImage, ClientError> {
    let refused = |source| ClientError::Seal { path: image.to_owned(), source };
    let keypoints = features.keypoints.len();
    let mut rng = device_rng().map_err(refused)?;
    let query = seal(features, &camera, profile, options, &mut rng).map_err(refused)?;
    Ok(SealedImage { query, keypoints })
}
