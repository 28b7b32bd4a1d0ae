//! Extracts the features of the map's images.

use std::path::Path;

use rayon::prelude::*;
use veiloc_features::{Extractor, FeatureError, Image, Limits, SharedGlobal, extract_loaded, load_mask};
use veiloc_geometry::Intrinsics;
use veiloc_map::PosedImage;
use veiloc_protocol::ExtractionLimits;

use crate::error::MappingError;
use crate::input::bad_image::{BadImage, BadReason};
use crate::input::cache::{BuildCache, ExtractedFeatures, FeatureRequest};
use crate::input::image_names::{image_file, mask_file};
use crate::input::{CheckedImages, split_usable};
use crate::progress::Progress;

/// Extractors of local features and of the global descriptor.
#[derive(Clone, Copy)]
pub(crate) struct ExtractorPair<'a> {
    pub(crate) extractor: &'a dyn Extractor,
    pub(crate) global: Option<&'a SharedGlobal>,
}

/// The readable images, and the result for each.
pub(crate) struct ExtractionResult<'a, T> {
    /// `[N]`
    pub(crate) images: Vec<&'a PosedImage>,
    /// `[N]`
    pub(crate) features: Vec<T>,
    /// The images that were left out, by the earlier check and during extraction.
    pub(crate) skipped: Vec<BadImage>,
}

/// Extracts the features of images, in their order.
pub(crate) fn extract_all<'a>(
    input: CheckedImages<'a>,
    extractor_pair: ExtractorPair<'_>,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<ExtractionResult<'a, ExtractedFeatures>, MappingError> {
    extract_each(input, extractor_pair, limits, progress, |_, extracted| extracted)
}

/// Like [`extract_all`], and processes the features of each image while others are still being extracted.
pub(crate) fn extract_each<'a, T: Send>(
    input: CheckedImages<'a>,
    extractor_pair: ExtractorPair<'_>,
    limits: ExtractionLimits,
    progress: &dyn Progress,
    then: impl Fn(&PosedImage, ExtractedFeatures) -> T + Sync,
) -> Result<ExtractionResult<'a, T>, MappingError> {
    let CheckedImages { images, mut skipped, folder, masks, on_bad, cache } = input;
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let stored = extractor_pair.extractor.stored().and_then(|stored| stored.of_images(folder, &names));
    let extractor_pair =
        ExtractorPair { extractor: stored.as_deref().unwrap_or(extractor_pair.extractor), ..extractor_pair };
    progress.start("Extracting features", images.len());
    let all: Vec<Result<(&PosedImage, T), BadImage>> = images
        .into_par_iter()
        .map(|image| {
            let mask = masks.map(|masks| mask_file(masks, &image.name)).filter(|mask| mask.exists());
            let path = image_file(folder, &image.name);
            let extracted = extract(&path, mask.as_deref(), &image.camera, extractor_pair, limits, cache);
            progress.advance(1);
            let extracted =
                extracted.map_err(|e| BadImage { name: image.name.clone(), reason: BadReason::Image(e) })?;
            Ok((image, then(image, extracted)))
        })
        .collect();
    let (good, bad) = split_usable(all, on_bad)?;
    skipped.extend(bad);
    let (images, features) = good.into_iter().unzip();
    Ok(ExtractionResult { images, features, skipped })
}

fn extract(
    path: &Path,
    mask: Option<&Path>,
    camera: &Intrinsics,
    extractor_pair: ExtractorPair<'_>,
    limits: ExtractionLimits,
    cache: Option<&dyn BuildCache>,
) -> Result<ExtractedFeatures, FeatureError> {
    let size = (camera.width, camera.height);
    let request = FeatureRequest {
        path,
        mask,
        size,
        limits,
        kind: extractor_pair.extractor.kind(),
        global: extractor_pair.global.is_some(),
    };
    // Stored features need no cache.
    let cache = cache.filter(|_| extractor_pair.extractor.stored().is_none());
    if let Some(found) = cache.and_then(|cache| cache.features(&request)) {
        return Ok(found);
    }
    let limits = Limits { max_keypoints: limits.max_keypoints as usize, max_side: limits.max_image_side };
    let mut image = Image::open(path)?;
    match mask.map(load_mask) {
        // Of an image without people.
        None | Some(Err(FeatureError::HidesNothing { .. })) => {}
        Some(mask) => image = image.without(&mask?)?,
    }
    let global = extractor_pair.global.map(|own| own.describe(&image)).transpose()?;
    let features = extract_loaded(image, Some(size), extractor_pair.extractor, limits)?.features_in_file();
    let keypoints: Vec<[f32; 2]> =
        features.keypoints.iter().map(|k| [k.pixel.u as f32, k.pixel.v as f32]).collect();
    let found = ExtractedFeatures { keypoints, descriptors: features.descriptors, global };
    if let Some(cache) = cache {
        cache.store_features(&request, &found);
    }
    Ok(found)
}
