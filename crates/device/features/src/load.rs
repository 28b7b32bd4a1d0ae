//! Images from files. The only metadata that is read (EXIF) is the focal length, in `exif.rs`, and only on request:
//! other metadata could leak.
//!
//! **Orientation.** Pixels are those that are stored: what a file says about its display (EXIF orientation, and the rotation,
//! mirroring and crop of HEIC) is not applied, as in COLMAP. All photographs of a phone then have one camera, in
//! portrait and in landscape. The program, the Python package and the browser have this one rule.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

#[cfg(feature = "heic")]
use crate::heic;
use crate::jpeg::complete_jpeg;
use crate::{FeatureError, GrayImage};

/// The largest image that is read, total pixels: 100 million, several times the size of phone images.
pub const MAX_PIXELS: u64 = 100_000_000;

/// Extensions of the image files that are read, lower case.
#[cfg(feature = "heic")]
pub const IMAGE_EXTENSIONS: &[&str] = &["jpg", "jpeg", "png", "webp", "heic", "heif"];
/// Extensions of the image files that are read, lower case.
#[cfg(not(feature = "heic"))]
pub const IMAGE_EXTENSIONS: &[&str] = &["jpg", "jpeg", "png", "webp"];

/// The spellings of [`IMAGE_EXTENSIONS`]: lower case, then upper case.
pub fn spelled_image_extensions() -> impl Iterator<Item = String> + Clone {
    IMAGE_EXTENSIONS.iter().flat_map(|lower| [(*lower).to_owned(), lower.to_uppercase()])
}

/// The names of their formats, for messages.
#[cfg(feature = "heic")]
pub const IMAGE_FORMATS: &str = "JPEG, PNG, WebP or HEIC";
/// The names of their formats, for messages.
#[cfg(not(feature = "heic"))]
pub const IMAGE_FORMATS: &str = "JPEG, PNG or WebP";

/// Whether a file has the extension of an image that is read; upper and lower case are the same.
pub fn is_image_file(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| IMAGE_EXTENSIONS.contains(&extension.as_str()))
}

/// Width and height of an image file, pixels as they are stored; pixels are not decoded.
///
/// # Errors
/// As [`load_gray`], but for damage behind the header.
pub fn image_size(path: &Path) -> Result<(u32, u32), FeatureError> {
    Ok(header(path)?.size)
}

/// Reads an image file ([`IMAGE_FORMATS`]) as gray in [0, 1].
///
/// Gray is Rec. 709 luma of the stored values, as in COLMAP (but not rounded to a byte); transparency is ignored. The
/// orientation is *not* applied, so coordinates are those of the stored pixels, as in COLMAP.
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

/// All pixels of a complete image file, as they are stored.
pub(crate) fn decode(path: &Path) -> Result<DynamicImage, FeatureError> {
    let bytes = read(path)?;
    let refused = |reason: String| FeatureError::Decode { path: path.into(), reason };
    match format_of(&bytes).map_err(refused)? {
        #[cfg(feature = "heic")]
        Format::Heic => {
            check_size(path, heic::size(&bytes).map_err(|e| refused(damaged(e)))?)?;
            heic::decode(&bytes).map_err(|e| refused(damaged(e)))
        }
        Format::Other(format) => {
            let decoder = decoder(path, &bytes, format)?;
            DynamicImage::from_decoder(decoder).map_err(|e| refused(damaged(e)))
        }
    }
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
    let bytes = read(path)?;
    let refused = |reason: String| FeatureError::Decode { path: path.into(), reason };
    match format_of(&bytes).map_err(refused)? {
        #[cfg(feature = "heic")]
        Format::Heic => {
            let size = heic::size(&bytes).map_err(|e| refused(damaged(e)))?;
            check_size(path, size)?;
            Ok(Header { size, metadata: heic::exif(&bytes) })
        }
        Format::Other(format) => {
            let mut decoder = decoder(path, &bytes, format)?;
            // Unreadable metadata counts as absent; the caller decides whether it is needed.
            let metadata = decoder.exif_metadata().ok().flatten();
            Ok(Header { size: decoder.dimensions(), metadata })
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, FeatureError> {
    std::fs::read(path).map_err(|source| FeatureError::Read { path: path.into(), source })
}

/// A decoder of a complete file within the size limit.
fn decoder<'a>(
    path: &Path,
    bytes: &'a [u8],
    format: ImageFormat,
) -> Result<impl ImageDecoder + 'a, FeatureError> {
    let refused = |reason: String| FeatureError::Decode { path: path.into(), reason };
    let bytes = match format {
        ImageFormat::Jpeg => complete_jpeg(bytes).map_err(|reason| refused(damaged(reason)))?,
        _ => Cow::Borrowed(bytes),
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.no_limits(); // the limit below is in pixels
    let decoder = reader.into_decoder().map_err(|e| refused(damaged(e)))?;
    check_size(path, decoder.dimensions())?;
    Ok(decoder)
}

fn check_size(path: &Path, (width, height): (u32, u32)) -> Result<(), FeatureError> {
    if width == 0 || height == 0 {
        return Err(FeatureError::Decode { path: path.into(), reason: damaged("it has no pixels") });
    }
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(FeatureError::TooLarge { path: path.into(), width, height, max_pixels: MAX_PIXELS });
    }
    Ok(())
}

/// The message for a damaged file.
fn damaged(reason: impl std::fmt::Display) -> String {
    format!("{reason}; copy it again, or export it again as JPEG or PNG")
}

/// A format that is read.
enum Format {
    #[cfg(feature = "heic")]
    Heic,
    Other(ImageFormat),
}

/// The format of a file by its content; for others, an error with the name and the remedy.
fn format_of(bytes: &[u8]) -> Result<Format, String> {
    let name = match (image::guess_format(bytes), bytes.get(4..12)) {
        (Ok(format @ (ImageFormat::Jpeg | ImageFormat::Png | ImageFormat::WebP)), _) => {
            return Ok(Format::Other(format));
        }
        (_, Some(b"ftypheic" | b"ftypheix" | b"ftypheim" | b"ftyphevc" | b"ftypmif1" | b"ftypmsf1")) => {
            #[cfg(feature = "heic")]
            return Ok(Format::Heic);
            #[cfg(not(feature = "heic"))]
            "HEIC"
        }
        (_, Some(b"ftypavif" | b"ftypavis")) => "AVIF",
        (Ok(other), _) => other.extensions_str().first().copied().unwrap_or("other"),
        (Err(_), _) if bytes.is_empty() => return Err(damaged("the file is empty")),
        (Err(_), _) => return Err(format!("it is not an image; give a {IMAGE_FORMATS} file")),
    };
    Err(format!("{} files are not read; convert it to JPEG or PNG", name.to_uppercase()))
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
