//! What a device does before it seals: read the image, and extract what the profile asks for.

use std::path::Path;

use veiloc_features::{ExtractedImage, Extractor, Extractors, Features, Image, Limits, Mask, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_protocol::Profile;

use crate::{SealError, SealOptions};

/// Features of an image as the profile asks for them, within what the device allows, with the global descriptor of the image where
/// the owner consented to it, and the camera of the image they are in: an image larger than the limit is made smaller first, and its camera with it.
///
/// Descriptors do not show the image's border (rule L11): the image is continued by its mirror image, and with another
/// extractor keypoints that look over the border are left out.
///
/// # Errors
/// [`SealError`] when the file is no image, or not of the camera's size, or the profile asks for features or limits
/// this device does not have.
pub fn extract(
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    extract_with(options.extractors(), path, camera, profile, options)
}

/// As [`extract`], of an image of which a mask hides a part. Nothing of what it hides is looked at: features of two images that
/// differ there only are the very same, and no keypoint is kept whose descriptor looks there (rule L13).
///
/// # Errors
/// As [`extract`]; [`FeatureError::MaskSize`](veiloc_features::FeatureError::MaskSize) for a mask of another image.
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

/// As [`extract`], with other extractors than those of the options.
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
    let (extractor, limits) = asked(extractors, profile, options)?;
    extract_by(extractor, limits, Image::from(load_gray(path)?), path, camera, profile, options)
}

/// As [`extract`], of an image that is in memory already: `path` is the file it came from, or what messages are to call
/// it. What was taken out of it with [`Image::without`] is in no feature.
///
/// # Errors
/// As [`extract`], but for reading the file.
pub fn extract_loaded(
    image: Image,
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(Features, Intrinsics), SealError> {
    let (extractor, limits) = asked(options.extractors(), profile, options)?;
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
    let size = Some((camera.width, camera.height));
    // Of the image as it is seen here, without what masks hide (rules L13 and L14).
    let global = options.image_global(profile)?.map(|own| own.describe(&image)).transpose()?;
    let image = veiloc_features::extract_loaded(image, path, size, extractor, limits)?;
    let (features, camera) = whole(image, extractor, camera);
    Ok((Features { global, ..features }, camera))
}

/// What may be sealed of an image: no descriptor that shows the image's border, and with it where its keypoint is.
fn whole(image: ExtractedImage, extractor: &dyn Extractor, camera: &Intrinsics) -> (Features, Intrinsics) {
    (image.features.whole(image.size, extractor.reach()), camera.resized(image.size.0, image.size.1))
}

/// One keypoint for so many that are sent is extracted beyond them: the window leaves out at most a ninth of an image of
/// 640 x 480, and a session what it must not tell again.
const SPARE: u32 = 3;

/// What the profile asks for, within what the device allows.
fn asked<'a>(
    extractors: &'a Extractors,
    profile: &Profile,
    options: &SealOptions,
) -> Result<(&'a dyn Extractor, Limits), SealError> {
    let bounded = options.bounded(profile)?;
    let extractor = extractors.of_kind(profile.descriptor_kind())?;
    // Some show the border, or lie beyond the window and are dropped when they are sealed (rule L11): without spare
    // ones an image would fall a size class.
    let spare = bounded.max_keypoints / SPARE;
    let limits =
        Limits { max_keypoints: (bounded.max_keypoints + spare) as usize, max_side: bounded.max_image_side };
    Ok((extractor, limits))
}
