//! Images from files. The only metadata that is read (EXIF) is the focal length, in `exif.rs`, and only on request:
//! other metadata could leak, and COLMAP ignores the orientation too.

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
    let image = decode(path)?;
    let (width, height) = (image.width(), image.height());
    match image {
        DynamicImage::ImageLuma8(gray) => GrayImage::from_luma8(width, height, gray.as_raw()),
        DynamicImage::ImageLuma16(gray) => {
            GrayImage::new(width, height, gray.as_raw().iter().map(|&v| f32::from(v) / 65535.0).collect())
        }
        other => GrayImage::from_rgb8(width, height, other.into_rgb8().as_raw()),
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
    if format == ImageFormat::Jpeg && !is_complete_jpeg(bytes) {
        return Err(refused(damaged("the end of the image is missing")));
    }
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
/// the end marker.
///
/// Segments are skipped by their length, because a preview inside one has its own end marker. Within the coded samples,
/// `FF 00` is a sample and `FF D0`..`FF D7` a restart.
fn is_complete_jpeg(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    const END: u8 = 0xD9;
    let mut at = 2;
    let mut in_scan = false;
    while let Some(&[first, marker]) = bytes.get(at..at + 2) {
        match (first, marker) {
            (0xFF, END) => return true,
            (0xFF, 0xFF) => at += 1,
            (0xFF, 0x00 | 0x01 | 0xD0..=0xD7) => at += 2,
            (0xFF, _) => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { return false };
                at += 2 + usize::from(u16::from_be_bytes([high, low]));
                in_scan = marker == START_OF_SCAN;
            }
            _ if in_scan => at += 1,
            _ => return false,
        }
    }
    false
}
