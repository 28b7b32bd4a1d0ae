//! Images inside the page.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, ImageEncoder as _, RgbImage};

/// Longest side on the page, pixels.
const LONGEST: u32 = 1000;

/// A `data:` address of the image as JPEG; `None` for an empty image.
pub(super) fn data_address(image: &RgbImage) -> Option<String> {
    let (w, h) = image.dimensions();
    let shrink = (f64::from(LONGEST) / f64::from(w.max(h).max(1))).min(1.0);
    let size = |n: u32| ((f64::from(n) * shrink) as u32).max(1);
    let small;
    let shown = if shrink < 1.0 {
        small = resize(image, size(w), size(h), FilterType::Triangle);
        &small
    } else {
        image
    };
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 84).encode_image(shown).ok()?;
    Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

/// A `data:` address of a small image pixel by pixel, as PNG; `pixels`: `[height, width, 3]`. `None` for an empty image, and for
/// pixels that are not as many.
pub(super) fn exact_address([width, height]: [u32; 2], pixels: &[u8]) -> Option<String> {
    let wanted = u64::from(width) * u64::from(height) * 3;
    if wanted == 0 || pixels.len() as u64 != wanted {
        return None;
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(pixels, width, height, ExtendedColorType::Rgb8).ok()?;
    Some(format!("data:image/png;base64,{}", STANDARD.encode(bytes)))
}
