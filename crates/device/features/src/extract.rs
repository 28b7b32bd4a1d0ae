//! The entry point from an image, in a file or in memory, to features: read, check the size, scale down, extract.

use std::path::Path;

use crate::{Extractor, FeatureError, Features, Image, orientation};

/// How much to extract from an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Most keypoints, strongest first.
    pub max_keypoints: usize,
    /// Longest side of the image, pixels; larger images are scaled down first.
    pub max_side: u32,
}

/// Features of an image, with the sizes of the image.
#[derive(Debug, Clone)]
pub struct ExtractedImage {
    /// Features in pixels of the image used for extraction, which may be smaller than the file.
    pub features: Features,
    /// Width and height of the image used for extraction, pixels.
    pub size: (u32, u32),
    /// Width and height of the image in the file, pixels.
    pub size_in_file: (u32, u32),
}

impl ExtractedImage {
    /// The features with keypoints in pixels of the file.
    pub fn features_in_file(self) -> Features {
        let scale = |file: u32, own: u32| f64::from(file) / f64::from(own);
        self.features.scaled(scale(self.size_in_file.0, self.size.0), scale(self.size_in_file.1, self.size.1))
    }
}

/// Features of an image file.
///
/// `camera_size`: width and height of the camera's images, pixels; `None` when no camera is given. Only the pixels of
/// the file are read, with one exception: when the image fits the camera only with swapped sides, the error message
/// states the file's EXIF orientation. The orientation is never applied.
///
/// # Errors
/// [`FeatureError`]: not an image, too large, not of the camera's size, or an error of the extractor.
pub fn extract_image(
    path: &Path,
    camera_size: Option<(u32, u32)>,
    extractor: &dyn Extractor,
    limits: Limits,
) -> Result<ExtractedImage, FeatureError> {
    extract_loaded(Image::open(path)?, camera_size, extractor, limits)
}

/// As [`extract_image`], for an image that is already in memory. Pixels that a mask hid ([`Image::without`]) have no
/// influence on the features: keypoints whose descriptor window touches them are dropped.
///
/// `camera_size`: of the image as it is here, after its turn.
///
/// # Errors
/// [`FeatureError`]: not of the camera's size, stopped, or an error of the extractor; stored features ([`Extractor::stored`])
/// for an image with a mask.
pub fn extract_loaded(
    image: Image,
    camera_size: Option<(u32, u32)>,
    extractor: &dyn Extractor,
    limits: Limits,
) -> Result<ExtractedImage, FeatureError> {
    let size_in_file = (image.width(), image.height());
    if let Some(camera) = camera_size.filter(|camera| *camera != size_in_file) {
        let swapped = (camera.1, camera.0) == size_in_file;
        let turn = if swapped { orientation::turn_of(image.name()) } else { None };
        let [actual, camera] = [size_in_file, camera].map(|size| image.turns().size_of(size));
        return Err(FeatureError::ImageSize { path: image.name().into(), actual, camera, turn });
    }
    let image = image.limited(limits.max_side);
    let kind = extractor.kind();
    let mut features = match extractor.stored() {
        Some(_) if image.hidden().is_some() => {
            let reason = "they were made from the whole image, but a mask hides a part of it; extract them from the \
                          image without that part, or use an extractor that is available here";
            return Err(FeatureError::Extractor { name: kind.name().to_owned(), reason: reason.to_owned() });
        }
        Some(stored) => {
            let scale = |own: u32, file: u32| f64::from(own) / f64::from(file);
            let columns = scale(image.width(), size_in_file.0);
            let rows = scale(image.height(), size_in_file.1);
            stored.features(image.name(), size_in_file)?.scaled(columns, rows).strongest(limits.max_keypoints)
        }
        None => extractor.extract(&image, limits.max_keypoints)?,
    };
    if features.descriptors.kind() != kind || features.keypoints.len() != features.descriptors.len() {
        return Err(FeatureError::Extractor {
            name: kind.name().to_owned(),
            reason: "it did not make one descriptor of its kind for each keypoint".to_owned(),
        });
    }
    // Not every extractor checks it.
    if image.stop().is_set() {
        return Err(FeatureError::Stopped);
    }
    if let Some(hidden) = image.hidden() {
        let size = (image.width(), image.height());
        features = features.clear_of(hidden, size, extractor.receptive_field());
    }
    Ok(ExtractedImage { features, size: (image.width(), image.height()), size_in_file })
}
