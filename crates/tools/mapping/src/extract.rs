//! Extracts the features of the map's images.

use std::path::Path;

use rayon::prelude::*;
use veiloc_features::{Extractor, FeatureError, Image, Limits, SharedGlobal, extract_loaded, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_map::PosedImage;
use veiloc_protocol::ExtractionLimits;

use crate::bad_image::{BadImage, BadReason};
use crate::error::MappingError;
use crate::input::{Checked, sift};
use crate::kept::{Extracted, Kept, Wanted};
use crate::progress::Progress;

/// Extractors of local features and of the global descriptor.
#[derive(Clone, Copy)]
pub(crate) struct Makers<'a> {
    pub(crate) extractor: &'a dyn Extractor,
    pub(crate) global: Option<&'a SharedGlobal>,
}

/// The readable images, and the result for each.
pub(crate) struct Found<'a, T> {
    /// `[N]`
    pub(crate) images: Vec<&'a PosedImage>,
    /// `[N]`
    pub(crate) features: Vec<T>,
    /// The images that were left out, by the earlier check and during extraction.
    pub(crate) skipped: Vec<BadImage>,
}

/// Extracts the features of images, in their order.
pub(crate) fn extract_all<'a>(
    input: Checked<'a>,
    makers: Makers<'_>,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<Found<'a, Extracted>, MappingError> {
    extract_each(input, makers, limits, progress, |_, extracted| extracted)
}

/// Like [`extract_all`], and processes the features of each image while others are still being extracted.
pub(crate) fn extract_each<'a, T: Send>(
    input: Checked<'a>,
    makers: Makers<'_>,
    limits: ExtractionLimits,
    progress: &dyn Progress,
    then: impl Fn(&PosedImage, Extracted) -> T + Sync,
) -> Result<Found<'a, T>, MappingError> {
    let Checked { images, mut skipped, folder, on_bad, kept } = input;
    progress.start("Extracting features", images.len());
    let all: Vec<Result<(&PosedImage, T), BadImage>> = images
        .into_par_iter()
        .map(|image| {
            let extracted = extract(&folder.join(&image.name), &image.camera, makers, limits, kept);
            progress.advance(1);
            let extracted =
                extracted.map_err(|e| BadImage { name: image.name.clone(), reason: BadReason::Image(e) })?;
            Ok((image, then(image, extracted)))
        })
        .collect();
    let (good, bad) = sift(all, on_bad)?;
    skipped.extend(bad);
    let (images, features) = good.into_iter().unzip();
    Ok(Found { images, features, skipped })
}

fn extract(
    path: &Path,
    camera: &Intrinsics,
    makers: Makers<'_>,
    limits: ExtractionLimits,
    kept: Option<&dyn Kept>,
) -> Result<Extracted, FeatureError> {
    let size = (camera.width, camera.height);
    let wanted =
        Wanted { path, size, limits, kind: makers.extractor.kind(), global: makers.global.is_some() };
    // Stored features need no cache.
    let kept = kept.filter(|_| makers.extractor.stored().is_none());
    if let Some(found) = kept.and_then(|kept| kept.features(&wanted)) {
        return Ok(found);
    }
    let limits = Limits { max_keypoints: limits.max_keypoints as usize, max_side: limits.max_image_side };
    let image = Image::from(load_gray(path)?);
    let global = makers.global.map(|own| own.describe(&image)).transpose()?;
    let features = extract_loaded(image, path, Some(size), makers.extractor, limits)?.features_in_file();
    let keypoints: Vec<[f32; 2]> =
        features.keypoints.iter().map(|k| [k.pixel.u as f32, k.pixel.v as f32]).collect();
    let found = Extracted { keypoints, descriptors: features.descriptors, global };
    if let Some(kept) = kept {
        kept.keep_features(&wanted, &found);
    }
    Ok(found)
}
