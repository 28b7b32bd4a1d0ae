//! Features of the map's images.

use std::collections::BTreeSet;
use std::path::Path;

use rayon::prelude::*;
use veiloc_descriptor::Descriptors;
use veiloc_features::{Limits, Sift, extract_image};
use veiloc_geometry::Intrinsics;
use veiloc_map::colmap::{ColmapImage, ColmapModel};
use veiloc_query::ExtractionLimits;

use crate::error::MappingError;
use crate::progress::Progress;

/// What was found in one image.
pub(crate) struct Extracted {
    /// `[N]`, pixels of the image as it was taken.
    pub(crate) keypoints: Vec<[f32; 2]>,
    /// `[N, dim]`
    pub(crate) descriptors: Descriptors,
}

/// The images with these names, in their order.
pub(crate) fn select<'a>(
    posed: &'a ColmapModel,
    names: &[String],
) -> Result<Vec<&'a ColmapImage>, MappingError> {
    if names.is_empty() {
        return Err(MappingError::EmptyList);
    }
    let mut seen = BTreeSet::new();
    names
        .iter()
        .map(|name| {
            if !seen.insert(name) {
                return Err(MappingError::DuplicateName { name: name.clone() });
            }
            posed.image_by_name(name).ok_or_else(|| MappingError::NoPose { name: name.clone() })
        })
        .collect()
}

/// Extracts the features of images, in their order; the first error in that order, if there is one.
pub(crate) fn extract_all(
    images: &[&ColmapImage],
    posed: &ColmapModel,
    image_dir: &Path,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<Vec<Extracted>, MappingError> {
    extract_each(images, posed, image_dir, limits, progress, |_, extracted| extracted)
}

/// The same, and does something with the features of each image while those of others are still extracted.
pub(crate) fn extract_each<T: Send>(
    images: &[&ColmapImage],
    posed: &ColmapModel,
    image_dir: &Path,
    limits: ExtractionLimits,
    progress: &dyn Progress,
    then: impl Fn(&ColmapImage, Extracted) -> T + Sync,
) -> Result<Vec<T>, MappingError> {
    progress.start("Extracting features", images.len());
    let all: Vec<Result<T, MappingError>> = images
        .par_iter()
        .map(|image| {
            let extracted = extract(&image_dir.join(&image.name), posed.camera_of(image), limits);
            progress.advance(1);
            Ok(then(image, extracted?))
        })
        .collect();
    all.into_iter().collect()
}

fn extract(path: &Path, camera: &Intrinsics, limits: ExtractionLimits) -> Result<Extracted, MappingError> {
    let limits = Limits { max_keypoints: limits.max_keypoints as usize, max_side: limits.max_image_side };
    let size = Some((camera.width, camera.height));
    let features = extract_image(path, size, &Sift::default(), limits)?.features_in_file();
    let keypoints: Vec<[f32; 2]> =
        features.keypoints.iter().map(|k| [k.pixel.u as f32, k.pixel.v as f32]).collect();
    Ok(Extracted { keypoints, descriptors: features.descriptors })
}
