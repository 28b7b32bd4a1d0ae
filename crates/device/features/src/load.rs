//! Images from files. The only metadata that is read (EXIF) is the focal length, in `exif.rs`, and only on request:
//! other metadata could leak, and COLMAP ignores the orientation too.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use crate::{FeatureError, GrayImage};

/// The largest image that is read, total pixels: 100 million, several times the size of phone images.
pub const MAX_PIXELS: u64 = 100_000_000;

/// Reads a JPEG or PNG file as gray in [0, 1].
///
/// Gray is Rec. 709 luma of the stored values, as in COLMAP (but not rounded to a byte); transparency is ignored. The
/// EXIF orientation is *not* applied, so coordinates are those of the stored pixels, as in COLMAP.
///
/// # Errors
/// [`FeatureError::Read`], [`FeatureError::Decode`] (also when the file is truncated) or [`FeatureError::TooLarge`].
pub fn load_gray(path: &Path) -> Result<GrayImage, FeatureError> {
    let image = decode_photo(path)?;
    let (width, height) = (image.width(), image.height());
    match image {
        DynamicImage::ImageLuma8(gray) => GrayImage::from_luma8(width, height, gray.as_raw()),
        DynamicImage::ImageLuma16(gray) => {
            GrayImage::new(width, height, gray.as_raw().iter().map(|&v| f32::from(v) / 65535.0).collect())
        }
        other => GrayImage::from_rgb8(width, height, other.into_rgb8().as_raw()),
    }
}

/// As [`decode`], for an image whose brightness counts: values that fill only the low bits of their range are refused.
///
/// # Errors
/// [`FeatureError::Decode`] with the brightest value.
pub(crate) fn decode_photo(path: &Path) -> Result<DynamicImage, FeatureError> {
    let image = decode(path)?;
    match brightest_of_16_bits(&image) {
        Some(brightest @ 1..=MAX_LOW_BITS) => {
            let bits = u16::BITS - brightest.leading_zeros();
            let factor = u16::MAX / (u16::MAX >> (u16::BITS - bits));
            let reason = format!(
                "the brightest value is {brightest} of 65535: values of {bits} bits seem to be stored in 16 bits; multiply \
                 them by {factor}, or save the image with 8 bits"
            );
            Err(FeatureError::Decode { path: path.into(), reason })
        }
        _ => Ok(image),
    }
}

/// The largest value of 12 bits. No photograph of 16 bits is that dark everywhere: of 8 bits it would use 16 values.
const MAX_LOW_BITS: u16 = 0xfff;

/// The largest gray or colour value of an image with 16 bits; `None` for other images.
fn brightest_of_16_bits(image: &DynamicImage) -> Option<u16> {
    // Without the last channel, which is transparency.
    let opaque = |samples: &[u16], channels: usize| {
        samples.chunks_exact(channels).flat_map(|pixel| &pixel[..channels - 1]).max().copied()
    };
    match image {
        DynamicImage::ImageLuma16(image) => image.iter().max().copied(),
        DynamicImage::ImageRgb16(image) => image.iter().max().copied(),
        DynamicImage::ImageLumaA16(image) => opaque(image, 2),
        DynamicImage::ImageRgba16(image) => opaque(image, 4),
        _ => None,
    }
}

/// All pixels of a complete JPEG or PNG file, as they are stored.
pub(crate) fn decode(path: &Path) -> Result<DynamicImage, FeatureError> {
    let bytes = std::fs::read(path).map_err(|source| FeatureError::Read { path: path.into(), source })?;
    DynamicImage::from_decoder(decoder(path, &bytes)?)
        .map_err(|e| FeatureError::Decode { path: path.into(), reason: damaged(e) })
}

/// The header of an image file.
pub(crate) struct Header {
    /// Width and height, pixels.
    pub(crate) size: (u32, u32),
    /// EXIF data, if present.
    pub(crate) metadata: Option<Vec<u8>>,
}

/// The header of an image file; pixels are not decoded.
pub(crate) fn header(path: &Path) -> Result<Header, FeatureError> {
    let bytes = std::fs::read(path).map_err(|source| FeatureError::Read { path: path.into(), source })?;
    let mut decoder = decoder(path, &bytes)?;
    // Unreadable metadata counts as absent; the caller decides whether it is needed.
    let metadata = decoder.exif_metadata().ok().flatten();
    Ok(Header { size: decoder.dimensions(), metadata })
}

/// A complete JPEG or PNG within the size limit.
fn decoder<'a>(path: &Path, bytes: &'a [u8]) -> Result<impl ImageDecoder + 'a, FeatureError> {
    let refused = |reason: String| FeatureError::Decode { path: path.into(), reason };
    let format = known_format(bytes).map_err(refused)?;
    let bytes = match format {
        ImageFormat::Jpeg => complete_jpeg(bytes).map_err(|reason| refused(damaged(reason)))?,
        _ => Cow::Borrowed(bytes),
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.no_limits(); // the limit below is in pixels
    let decoder = reader.into_decoder().map_err(|e| refused(damaged(e)))?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(refused(damaged("it has no pixels")));
    }
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(FeatureError::TooLarge { path: path.into(), width, height, max_pixels: MAX_PIXELS });
    }
    Ok(decoder)
}

/// The message for a damaged file.
fn damaged(reason: impl std::fmt::Display) -> String {
    format!("{reason}; copy it again, or export it again as JPEG or PNG")
}

/// JPEG or PNG; for other formats, such as those of phones, an error with the name and the remedy.
fn known_format(bytes: &[u8]) -> Result<ImageFormat, String> {
    let name = match (image::guess_format(bytes), bytes.get(4..12)) {
        (Ok(format @ (ImageFormat::Jpeg | ImageFormat::Png)), _) => return Ok(format),
        (_, Some(b"ftypheic" | b"ftypheix" | b"ftypheim" | b"ftyphevc" | b"ftypmif1" | b"ftypmsf1")) => {
            "HEIC"
        }
        (_, Some(b"ftypavif" | b"ftypavis")) => "AVIF",
        (Ok(other), _) => other.extensions_str().first().copied().unwrap_or("other"),
        (Err(_), _) if bytes.is_empty() => return Err(damaged("the file is empty")),
        (Err(_), _) => return Err("it is not an image; give a JPEG or PNG file".into()),
    };
    Err(format!("{} files are not read; convert it to JPEG or PNG", display_name(name)))
}

/// The name of an image format as people write it.
fn display_name(name: &str) -> String {
    if name == "webp" { "WebP".to_owned() } else { name.to_uppercase() }
}

/// The decoder fills the missing part of a truncated JPEG with gray and reports success; so this walks its segments to
/// the end marker. Extraneous bytes between segments, which some cameras write, are left out, as libjpeg does.
///
/// Segments are skipped by their length, because a preview inside one has its own end marker. Within the coded samples,
/// `FF 00` is a sample and `FF D0`..`FF D7` a restart.
///
/// # Errors
/// What is wrong, and where.
fn complete_jpeg(bytes: &[u8]) -> Result<Cow<'_, [u8]>, String> {
    const START_OF_SCAN: u8 = 0xDA;
    const END: u8 = 0xD9;
    let mut at = 2;
    let mut in_scan = false;
    // Without the extraneous bytes before `copied`; empty if there are none.
    let (mut whole, mut copied) = (Vec::new(), 0);
    while let Some(&[first, marker]) = bytes.get(at..at + 2) {
        match (first, marker) {
            (0xFF, END) if whole.is_empty() => return Ok(Cow::Borrowed(bytes)),
            (0xFF, END) => {
                whole.extend_from_slice(&bytes[copied..]);
                return Ok(Cow::Owned(whole));
            }
            (0xFF, 0xFF) => at += 1,
            (0xFF, 0x00 | 0x01 | 0xD0..=0xD7) => at += 2,
            (0xFF, _) => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { break };
                let length = usize::from(u16::from_be_bytes([high, low]));
                if length < 2 {
                    return Err(format!("the segment at byte {at} has a length of {length}"));
                }
                at += 2 + length;
                in_scan = marker == START_OF_SCAN;
            }
            _ if in_scan => at += 1,
            _ => {
                let rest = &bytes[at..];
                let next = rest.windows(2).position(|pair| pair[0] == 0xFF && pair[1] != 0);
                let Some(length) = next else {
                    return Err(format!(
                        "no segment follows at byte {at}, and the end of the image is missing"
                    ));
                };
                whole.extend_from_slice(&bytes[copied..at]);
                at += length;
                copied = at;
            }
        }
    }
    Err("the end of the image is missing".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg() -> Vec<u8> {
        let pixels = image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8 * 5, y as u8 * 7, 90]));
        let mut bytes = Cursor::new(Vec::new());
        pixels.write_to(&mut bytes, ImageFormat::Jpeg).expect("encoded");
        bytes.into_inner()
    }

    fn decoded(bytes: &[u8]) -> Result<DynamicImage, FeatureError> {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a.jpg");
        std::fs::write(&path, bytes).expect("written");
        decode(&path)
    }

    #[test]
    fn extraneous_bytes_between_segments_are_skipped() {
        let whole = jpeg();
        let expected = decoded(&whole).expect("a JPEG").into_rgb8();
        // Behind the first segment, and behind the second too.
        let second = 4 + usize::from(u16::from_be_bytes([whole[4], whole[5]]));
        for extra in [&[0_u8, 0][..], &[1, 2, 0xFF, 0, 7]] {
            let mut bytes = whole.clone();
            bytes.splice(second..second, extra.iter().copied());
            assert_ne!(bytes, whole);
            assert_eq!(decoded(&bytes).expect("as libjpeg").into_rgb8(), expected, "{extra:?}");
            let cut = &bytes[..bytes.len() * 2 / 3];
            assert!(decoded(cut).is_err_and(|e| e.to_string().contains("the end of the image is missing")));
        }
        assert!(matches!(complete_jpeg(&whole), Ok(Cow::Borrowed(_))));
        let mut zeros = whole[..second].to_vec();
        zeros.extend([0; 100]);
        let error = decoded(&zeros).expect_err("no further segment").to_string();
        assert!(error.contains(&format!("at byte {second}")), "{error}");
    }

    #[test]
    fn low_bits_in_16_bits_are_refused_with_the_remedy() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a.png");
        let load = |brightest: u16| {
            let shade = |x: u32, y: u32| ((2 * x * y) as u16).min(brightest);
            let gray = image::ImageBuffer::from_fn(70, 60, |x, y| image::Luma([shade(x, y)]));
            DynamicImage::ImageLuma16(gray).save(&path).expect("written");
            let of_gray = load_gray(&path).map(drop).map_err(|e| e.to_string());
            let rgba = image::ImageBuffer::from_fn(70, 60, |x, y| image::Rgba([0, shade(x, y), 0, u16::MAX]));
            DynamicImage::ImageRgba16(rgba).save(&path).expect("written");
            assert_eq!(load_gray(&path).map(drop).map_err(|e| e.to_string()), of_gray);
            of_gray
        };
        let error = load(255).expect_err("8 bits");
        assert!(error.contains("the brightest value is 255 of 65535") && error.contains("by 257"), "{error}");
        assert!(load(1023).is_err_and(|e| e.contains("10 bits") && e.contains("by 64")));
        assert_eq!(load(4096), Ok(()));
        assert_eq!(load(0), Ok(()), "a black image has no keypoints, which is said then");
    }
}
