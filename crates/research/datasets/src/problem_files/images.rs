//! Keypoints of images, as input of `veiloc attack` and of the training of predictors.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use veiloc_features::{Extractor, Limits, Progress, extract_image};
use veiloc_geometry::Pixel;
use veiloc_protocol::ExtractionLimits;

use crate::error::DatasetError;
use crate::problem_files::KeypointImage;

/// Keypoints and descriptors of one image, strongest keypoint first, named after the file.
///
/// An image larger than the limit is reduced first, and keypoints whose descriptor window crosses the border of the
/// image are dropped, as on a device (rule L11). Give an extractor as a device uses it
/// ([`Extractors::sealing`](veiloc_features::Extractors::sealing)): for other ones this drops keypoints that a device
/// sends. Positions and size belong to the reduced image
/// and are rounded to a thousandth of a pixel, so that a file preserves them exactly. Lens distortion is not removed.
///
/// # Errors
/// [`DatasetError::Features`] when the file is not an image.
pub fn keypoints_of_image(
    path: &Path,
    extractor: &dyn Extractor,
    limits: ExtractionLimits,
) -> Result<KeypointImage, DatasetError> {
    let limits = Limits { max_keypoints: limits.max_keypoints as usize, max_side: limits.max_image_side };
    let image = extract_image(path, None, extractor, limits)?;
    let (features, (width, height)) =
        (image.features.whole(image.size, extractor.support_radius()), image.size);
    Ok(KeypointImage {
        name: path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        width,
        height,
        keypoints: features.keypoints.iter().map(|k| rounded(k.pixel)).collect(),
        descriptors: Some(features.descriptors),
    })
}

fn rounded(p: Pixel) -> Pixel {
    let round = |x: f64| (x * 1e3).round() / 1e3;
    Pixel::new(round(p.u), round(p.v))
}

/// [`keypoints_of_image`] for many images, in their order.
///
/// # Errors
/// The first error in that order.
pub fn keypoints_of_images(
    paths: &[PathBuf],
    extractor: &dyn Extractor,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<Vec<KeypointImage>, DatasetError> {
    progress.start("Extracting keypoints", paths.len());
    let extracted: Vec<Result<KeypointImage, DatasetError>> = paths
        .par_iter()
        .map(|path| {
            let image = keypoints_of_image(path, extractor, limits);
            progress.advance(1);
            image
        })
        .collect();
    progress.finish();
    extracted.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use veiloc_features::{Compact, Sift};

    use super::*;
    use crate::problem_files::{encode_keypoints, read_keypoints};

    /// Blobs of several sizes on a ramp, so that features exist at several scales.
    fn image(path: &Path) {
        GrayImage::from_fn(160, 120, |x, y| {
            let (x, y) = (f64::from(x), f64::from(y));
            let wave = (x * (0.15 + x / 2000.0)).sin() * (y * 0.21).cos();
            image::Luma([(120.0 + 80.0 * wave + 0.2 * x) as u8])
        })
        .save(path)
        .expect("written");
    }

    #[test]
    fn keypoint_files_round_trip() {
        let folder = tempfile::tempdir().expect("temporary folder");
        for name in ["b.png", "a.PNG"] {
            image(&folder.path().join(name));
        }
        let paths = ["a.PNG", "b.png"].map(|name| folder.path().join(name));
        let mut limits = ExtractionLimits::default();
        (limits.max_keypoints, limits.max_image_side) = (40, 80);
        let extractors: [&dyn Extractor; 2] = [&Compact::for_sealing(), &Sift::for_sealing()];
        let [compact, images] =
            extractors.map(|e| keypoints_of_images(&paths, e, limits, &()).expect("images"));
        assert_eq!(images.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["a.PNG", "b.png"]);
        let image = &images[0];
        assert_eq!((image.width, image.height), (80, 60), "made smaller");
        assert_eq!(image.keypoints.len(), 40, "the strongest only");
        assert!(image.keypoints.iter().all(|p| (0.0..80.0).contains(&p.u) && (0.0..60.0).contains(&p.v)));
        for (images, gzip) in [(&images, false), (&images, true), (&compact, true)] {
            let file = folder.path().join("keypoints");
            std::fs::write(&file, encode_keypoints(images, gzip).expect("encoded")).expect("written");
            assert_eq!(&read_keypoints(&file).expect("read"), images, "gzip {gzip}");
        }
        let kind = |image: &KeypointImage| image.descriptors.as_ref().map(|d| d.kind().name().to_owned());
        assert_eq!(
            [&images[0], &compact[0]].map(kind),
            ["sift", "compact"].map(|name| Some(name.to_owned()))
        );
    }

    #[test]
    fn invalid_images_are_reported_by_name() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let check_message =
            |error: DatasetError, what: &str| assert!(error.to_string().contains(what), "{error}");
        let file = folder.path().join("a.png");
        std::fs::write(&file, "no image").expect("written");
        let limits = ExtractionLimits::default();
        check_message(keypoints_of_image(&file, &Sift::default(), limits).expect_err("no image"), "a.png");
    }
}
