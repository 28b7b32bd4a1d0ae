//! What a device does before it seals: it reads the image and extracts the features that the profile requests.

use std::path::Path;

use veiloc_features::{ExtractedImage, Extractor, Extractors, Features, Image, Limits, Mask, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_protocol::Profile;

use crate::{SealError, SealOptions};

/// Features of an image as the profile requests them, within the limits of the device, with the global descriptor of
/// the image if the owner consented to it, and the camera of the features. An image larger than the limit is scaled
/// down first, and its camera with it.
///
/// Descriptors do not show the image's border (rule L11): the image is continued by its mirror image; for other
/// extractors, keypoints whose descriptor window crosses the border are dropped.
///
/// # Errors
/// [`SealError`] when the file is not an image or does not have the camera's size, or when the profile requests
/// features or limits that this device does not offer.
pub fn extract(
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    extract_with(options.extractors(), path, camera, profile, options)
}

/// As [`extract`], for an image of which a mask hides a part. Hidden pixels are never read: two images that differ only
/// under the mask have equal features, and no keypoint is returned whose descriptor window touches the mask (rule L13).
///
/// # Errors
/// As [`extract`]; [`FeatureError::MaskSize`](veiloc_features::FeatureError::MaskSize) when the mask has another size.
pub fn extract_masked(
    path: &Path,
    mask: &Mask,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    let image = Image::from(load_gray(path)?).without(mask)?;
    extract_loaded(image, path, camera, profile, options)
}

/// As [`extract`], with the given extractors in place of those of the options.
///
/// # Errors
/// As [`extract`].
pub fn extract_with(
    extractors: &Extractors,
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    let (extractor, limits) = extraction_request(extractors, profile, options)?;
    extract_by(extractor, limits, Image::from(load_gray(path)?), path, camera, profile, options)
}

/// As [`extract`], for an image that is already in memory. `path` is the file it came from, or the name for messages.
/// Parts that were removed with [`Image::without`] are in no feature.
///
/// # Errors
/// As [`extract`], except for reading the file.
pub fn extract_loaded(
    image: Image,
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    let (extractor, limits) = extraction_request(options.extractors(), profile, options)?;
    extract_by(extractor, limits, image, path, camera, profile, options)
}

fn extract_by(
    extractor: &dyn Extractor,
    limits: Limits,
    image: Image,
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    let image = image.with_stop(options.stop());
    let size = Some((camera.width, camera.height));
    // Computed on the image after masking (rules L13 and L14).
    let global = options.image_global(profile)?.map(|own| own.describe(&image)).transpose()?;
    let image = veiloc_features::extract_loaded(image, path, size, extractor, limits)?;
    let (features, camera) = sealable(image, extractor, camera);
    Ok((Features { global, ..features }, camera))
}

/// The features that may be sealed: those whose descriptor does not reveal the image's border.
fn sealable(image: ExtractedImage, extractor: &dyn Extractor, camera: &Intrinsics) -> (Features, Intrinsics) {
    (image.features.whole(image.size, extractor.support_radius()), camera.resized(image.size.0, image.size.1))
}

/// One keypoint in addition to this many is extracted: the window drops up to a quarter of an image, and a session drops
/// keypoints that must not be sent again.
const SPARE: u32 = 2;

/// The extraction limits of the profile, within those of the device.
fn extraction_request<'a>(
    extractors: &'a Extractors,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(&'a dyn Extractor, Limits), SealError> {
    let bounded = options.bounded(profile)?;
    let extractor = extractors.of_kind(profile.descriptor_kind())?;
    // Some keypoints lie at the border or beyond the window and are dropped during sealing (rule L11). Without spare
    // ones an image would fall into a smaller size class.
    let spare = bounded.max_keypoints / SPARE;
    let limits =
        Limits { max_keypoints: (bounded.max_keypoints + spare) as usize, max_side: bounded.max_image_side };
    Ok((extractor, limits))
}
