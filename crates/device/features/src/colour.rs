//! Colour images, the input of detectors. Keypoints are extracted from gray images ([`crate::GrayImage`]).

use std::path::Path;

use crate::FeatureError;
use crate::load::decode_photo;

/// A colour image: red, green and blue, `[height, width, 3]`, at least one pixel.
#[derive(Clone, PartialEq, Eq)]
pub struct ColourImage {
    width: u32,
    height: u32,
    data: Vec<u8>,
}

// Rule L8: image content must not be logged.
impl std::fmt::Debug for ColourImage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ColourImage({}x{})", self.width, self.height)
    }
}

impl ColourImage {
    /// From bytes row by row, `[height, width, 3]`.
    ///
    /// # Errors
    /// [`FeatureError::Empty`] or [`FeatureError::Length`].
    pub fn new(width: u32, height: u32, data: Vec<u8>) -> Result<Self, FeatureError> {
        if width == 0 || height == 0 {
            return Err(FeatureError::Empty { width, height });
        }
        let (expected, actual) = (width as usize * height as usize * 3, data.len());
        if expected != actual {
            return Err(FeatureError::Length { width, height, expected, actual });
        }
        Ok(Self { width, height, data })
    }

    /// Columns.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// All samples row by row, `[height, width, 3]`.
    pub fn data(&self) -> &[u8] {
        &self.data
    }
}

/// Reads an image file ([`crate::IMAGE_FORMATS`]) in colour, with its pixels as they are stored, as [`crate::load_gray`] does.
///
/// # Errors
/// As [`crate::load_gray`].
pub fn load_colour(path: &Path) -> Result<ColourImage, FeatureError> {
    let image = decode_photo(path)?.into_rgb8();
    ColourImage::new(image.width(), image.height(), image.into_raw())
}
