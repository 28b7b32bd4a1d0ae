//! From an image file to the sealed query: the only module of this crate that seals.

use std::path::Path;

use veiloc_features::{Features, Mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{SealOptions, device_rng, extract, extract_masked, seal};
use veiloc_protocol::{Profile, SealedQuery};

use crate::ClientError;

/// An image, sealed.
#[derive(Debug)]
pub struct SealedImage {
    /// The query to send.
    pub query: SealedQuery,
    /// Number of keypoints found in the image; the query may hold fewer.
    pub keypoints: usize,
}

/// Seals an image, JPEG or PNG, for the map of a profile, with random numbers of the operating system.
///
/// - `camera`: of the image as it is in the file.
/// - `options`: how positions are hidden and how many keypoints are sent: the device's choice, independent of the
///   profile. `SealOptions::default()` is `dcl`.
///
/// Seal an image once and keep the query until it is answered: two queries of one image reveal its keypoints (rule L7).
/// If further images of one scene may be needed, seal all of them in one [`crate::SessionFile`] or
/// [`Session`](veiloc_obfuscation::Session): otherwise lines of two images cross in common keypoints (rule L10).
///
/// # Errors
/// [`ClientError`]: a file that is not an image, the camera of another image, too little texture, a profile that
/// requests more than the device allows.
pub fn seal_image(
    image: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<SealedImage, ClientError> {
    seal_extracted(image, extract(image, camera, profile, options)?, profile, options)
}

/// As [`seal_image`], without the pixels that a mask hides: they are never read, and two images that differ only there
/// give the same query (rule L13). The mask has the size of the image file; [`load_mask`](veiloc_features::load_mask)
/// reads one.
///
/// # Errors
/// As [`seal_image`]; [`ClientError`] for a mask of another size.
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
