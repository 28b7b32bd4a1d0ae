//! Images on pages: as `data:` addresses, and undistorted, so that the sent lines align with them.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, ImageEncoder as _, Rgb, RgbImage};
use veiloc_geometry::{Intrinsics, Pinhole, Pixel};

/// Longest side of an undistorted image, pixels.
const MAX_SIDE: u32 = 720;

/// The image of `from` in the camera `to`, reduced to at most 720 pixels a side; black outside the view of `from`.
/// Empty for an empty image or camera.
pub fn undistorted(image: &RgbImage, from: &Intrinsics, to: &Pinhole) -> RgbImage {
    let (width, height) = reduced(to.width, to.height);
    let (w, h) = image.dimensions();
    if w == 0 || h == 0 || to.width == 0 || to.height == 0 || from.width == 0 || from.height == 0 {
        return RgbImage::new(0, 0);
    }
    // Reduced first, so that fine structure is averaged and not aliased.
    let (sw, sh) = (width.min(w), height.min(h));
    let small = resize(image, sw, sh, FilterType::Triangle);
    let sx = f64::from(to.width) / f64::from(width);
    let sy = f64::from(to.height) / f64::from(height);
    let (rx, ry) = (f64::from(sw) / f64::from(from.width), f64::from(sh) / f64::from(from.height));
    RgbImage::from_fn(width, height, |x, y| {
        let pixel = Pixel::new((f64::from(x) + 0.5) * sx, (f64::from(y) + 0.5) * sy);
        let seen = from.project(to.unproject(pixel));
        sample(&small, seen.u * rx - 0.5, seen.v * ry - 0.5)
    })
}

/// A size with the same aspect ratio, at most [`MAX_SIDE`] a side.
pub fn reduced(width: u32, height: u32) -> (u32, u32) {
    let shrink = (f64::from(MAX_SIDE) / f64::from(width.max(height).max(1))).min(1.0);
    let size = |n: u32| ((f64::from(n) * shrink).round() as u32).max(1);
    (size(width), size(height))
}

/// Bilinear interpolation; black outside.
fn sample(image: &RgbImage, x: f64, y: f64) -> Rgb<u8> {
    let (w, h) = image.dimensions();
    if !(x > -1.0 && y > -1.0 && x < f64::from(w) && y < f64::from(h)) {
        return Rgb([0; 3]);
    }
    let (x, y) = (x.clamp(0.0, f64::from(w - 1)), y.clamp(0.0, f64::from(h - 1)));
    let (x0, y0) = (x.floor() as u32, y.floor() as u32);
    let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
    let (fx, fy) = (x.fract(), y.fract());
    let at = |x: u32, y: u32, c: usize| f64::from(image.get_pixel(x, y).0[c]);
    Rgb(std::array::from_fn(|c| {
        let above = at(x0, y0, c) * (1.0 - fx) + at(x1, y0, c) * fx;
        let below = at(x0, y1, c) * (1.0 - fx) + at(x1, y1, c) * fx;
        (above * (1.0 - fy) + below * fy).round() as u8
    }))
}

/// Longest side of an embedded image, pixels.
const MAX_EMBEDDED_SIDE: u32 = 1000;

/// A `data:` address of the image as JPEG; `None` for an empty image.
pub fn data_address(image: &RgbImage) -> Option<String> {
    let (w, h) = image.dimensions();
    let shrink = (f64::from(MAX_EMBEDDED_SIDE) / f64::from(w.max(h).max(1))).min(1.0);
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

/// A `data:` address of a small image as lossless PNG; `pixels`: `[height, width, 3]`. `None` for an empty image, and
/// for a wrong number of pixels.
pub fn lossless_address([width, height]: [u32; 2], pixels: &[u8]) -> Option<String> {
    let wanted = u64::from(width) * u64::from(height) * 3;
    if wanted == 0 || pixels.len() as u64 != wanted {
        return None;
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(pixels, width, height, ExtendedColorType::Rgb8).ok()?;
    Some(format!("data:image/png;base64,{}", STANDARD.encode(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc seen by a camera with distortion moves to where a pinhole camera sees it.
    #[test]
    fn undistortion_moves_a_disc_to_its_pinhole_position() {
        let from: Intrinsics = "SIMPLE_RADIAL,640,480,500,320,240,-0.2".parse().expect("valid");
        let to = from.pinhole();
        let point = veiloc_geometry::PlanePoint::new(0.5, -0.4);
        let (seen, wanted) = (from.project(point), to.project(point));
        assert!(seen.distance(&wanted) > 8.0, "there is distortion to undo");
        let image = RgbImage::from_fn(640, 480, |x, y| {
            let p = Pixel::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            Rgb([if p.distance(&seen) < 5.0 { 255 } else { 0 }; 3])
        });
        let flat = undistorted(&image, &from, &to);
        let (mut u, mut v, mut sum) = (0.0, 0.0, 0.0);
        for (x, y, p) in flat.enumerate_pixels() {
            let weight = f64::from(p.0[0]);
            u += weight * (f64::from(x) + 0.5);
            v += weight * (f64::from(y) + 0.5);
            sum += weight;
        }
        let middle = Pixel::new(u / sum, v / sum);
        assert!(middle.distance(&wanted) < 1.0, "{middle:?} {wanted:?}");
    }

    #[test]
    fn large_images_are_reduced_and_empty_ones_unchanged() {
        let from: Intrinsics = "SIMPLE_PINHOLE,4000,3000,3000,2000,1500".parse().expect("valid");
        let flat = undistorted(&RgbImage::from_pixel(400, 300, Rgb([9, 8, 7])), &from, &from.pinhole());
        assert_eq!(flat.dimensions(), (720, 540));
        assert_eq!(flat.get_pixel(300, 300).0, [9, 8, 7]);
        assert_eq!(undistorted(&RgbImage::new(0, 0), &from, &from.pinhole()).dimensions(), (0, 0));
    }
}
