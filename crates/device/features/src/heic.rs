//! HEIC files of phones: HEVC still images, and grids of them.
//!
//! Decoded by the crate `heic-decoder`, in Rust alone: decision 0063. Pixels are those of the coded image; rotation, mirroring
//! and crop of the container are not applied, as the EXIF orientation of other files is not.

use heic_decoder::{DecodeOptions, HeifError, decode_with, probe, read_metadata};
use image::{DynamicImage, RgbImage};

/// Width and height of the coded image, pixels.
pub(crate) fn size(bytes: &[u8]) -> Result<(u32, u32), HeifError> {
    let info = probe(bytes)?;
    let side =
        |side: usize| u32::try_from(side).map_err(|_| HeifError::LimitExceeded("the size of the image"));
    Ok((side(info.coded_width)?, side(info.coded_height)?))
}

/// EXIF data from its TIFF header on, if present.
pub(crate) fn exif(bytes: &[u8]) -> Option<Vec<u8>> {
    read_metadata(bytes).ok()?.exif
}

/// The pixels, 8 bits a channel.
pub(crate) fn decode(bytes: &[u8]) -> Result<DynamicImage, HeifError> {
    let pixels = decode_with(bytes, &DecodeOptions { apply_transforms: false })?.to_rgb8()?;
    let image = RgbImage::from_raw(pixels.width as u32, pixels.height as u32, pixels.data);
    image.map(DynamicImage::from).ok_or(HeifError::LimitExceeded("the size of the image"))
}
