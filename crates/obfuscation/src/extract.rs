//! What a device does before it seals: read the image, and extract what the profile asks for.

use std::path::{Path, PathBuf};

use veiloc_features::{FeatureError, Features, SiftOptions, extract_sift, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_query::Profile;

/// Why nothing was extracted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// The file is no image that can be read.
    #[error(transparent)]
    Image(#[from] FeatureError),
    /// The image is not of the camera's size.
    #[error(
        "{}: {}x{} pixels, but the camera takes {}x{}; give the camera of this image, or the image as the camera took it",
        path.display(), actual.0, actual.1, camera.0, camera.1
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// Its width and height.
        actual: (u32, u32),
        /// Width and height of the camera's images.
        camera: (u32, u32),
    },
}

/// Features of an image as the profile asks for them, and the camera of the image they are in: an image
/// larger than the profile's limit is made smaller first, and its camera with it.
///
/// # Errors
/// [`ExtractError`] when the file is no image, or not of the camera's size.
pub fn extract(
    path: &Path,
    camera: &Intrinsics,
    profile: &Profile,
) -> Result<(Features, Intrinsics), ExtractError> {
    let image = load_gray(path)?;
    let actual = (image.width(), image.height());
    if actual != (camera.width, camera.height) {
        let camera = (camera.width, camera.height);
        return Err(ExtractError::ImageSize { path: path.to_owned(), actual, camera });
    }
    let limits = profile.limits();
    let image = image.limited(limits.max_image_side);
    let mut options = SiftOptions::default();
    options.max_keypoints = limits.max_keypoints as usize;
    Ok((extract_sift(&image, &options), camera.resized(image.width(), image.height())))
}
