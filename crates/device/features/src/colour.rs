//! Colour images, the input of detectors and segmenters. Keypoints are extracted from gray images ([`crate::GrayImage`]).

use std::path::Path;

use veiloc_geometry::QuarterTurns;

use crate::load::decode_photo;
use crate::{FeatureError, GrayImage};

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

    /// Red, green and blue, from 0 to 1.
    pub(crate) fn channels(&self) -> [GrayImage; 3] {
        [0, 1, 2].map(|channel| {
            let samples = self.data.iter().skip(channel).step_by(3).map(|value| f32::from(*value) / 255.0);
            GrayImage::from_samples(self.width, self.height, samples.collect())
        })
    }

    /// The image turned clockwise.
    #[must_use]
    pub(crate) fn turned(&self, turns: QuarterTurns) -> Self {
        let size = (self.width, self.height);
        let (width, height) = turns.size_of(size);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| turns.source_of(size, (x, y))));
        let at = |(x, y): (u32, u32)| (y as usize * self.width as usize + x as usize) * 3;
        let data = pixels.flat_map(|from| self.data[at(from)..][..3].iter().copied()).collect();
        Self { width, height, data }
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
