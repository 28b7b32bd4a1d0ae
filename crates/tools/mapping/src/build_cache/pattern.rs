//! The extractor's output on a fixed pattern: it distinguishes two networks of the same name.

use crate::BuildOptions;
use veiloc_features::{FeatureError, GrayImage, Image};

use crate::build_cache::key::CacheKey;

/// Width and height of the pattern, pixels.
const SIZE: (u32, u32) = (160, 120);
/// Maximum number of compared features.
const MAX_FEATURES: usize = 64;

/// Adds the output of the local and global extractors on the pattern to the key.
pub(crate) fn add_extractor_output(key: &mut CacheKey, options: &BuildOptions) -> Result<(), FeatureError> {
    let extractor = options.extractors.named(&options.features)?;
    let image = Image::from(pattern()?);
    key.text(&options.features);
    if extractor.stored().is_none() {
        let features = extractor.extract(&image, MAX_FEATURES)?;
        key.numbers(features.keypoints.iter().flat_map(|k| [k.pixel.u, k.pixel.v]));
        key.bytes(features.descriptors.as_bytes());
    }
    if let Some(global) = &options.global {
        key.debug(&global.describe(&image)?.as_codes());
    }
    Ok(())
}

/// Blobs of several sizes and a few edges, so that every detector finds keypoints.
fn pattern() -> Result<GrayImage, FeatureError> {
    let (width, height) = SIZE;
    let at = |x: f32, y: f32| {
        let waves =
            (0.11 * x).sin() * (0.13 * y).cos() + 0.5 * (0.37 * x + 0.21 * y).sin() * (0.29 * y).sin();
        let blocks = if (x / 23.0).floor() as i32 % 2 == (y / 17.0).floor() as i32 % 2 { 0.2 } else { -0.2 };
        0.5 + 0.2 * waves + blocks
    };
    let samples = (0..height).flat_map(|y| (0..width).map(move |x| at(x as f32, y as f32)));
    // Quantized to bytes, so that the last bit of a sine has no effect.
    GrayImage::from_luma8(width, height, &samples.map(|v| (255.0 * v).round() as u8).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pattern_has_keypoints() {
        let options = BuildOptions::default();
        let extractor = options.extractors.named(&options.features).expect("built in");
        let features =
            extractor.extract(&Image::from(pattern().expect("an image")), MAX_FEATURES).expect("extracted");
        assert!(features.keypoints.len() > 10, "{}", features.keypoints.len());
    }

    #[test]
    fn other_extractors_give_other_keys() {
        let of = |name: &str| {
            let mut key = CacheKey::new("");
            let mut options = BuildOptions::default();
            name.clone_into(&mut options.features);
            add_extractor_output(&mut key, &options).expect("built in");
            key.digest()
        };
        assert_eq!(of("sift"), of("sift"));
        assert_ne!(of("sift"), of("compact"));
    }
}
