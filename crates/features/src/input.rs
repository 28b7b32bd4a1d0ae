//! What an extractor is given: one image in memory.

use crate::GrayImage;

/// An image as an extractor sees it: samples, and nothing else of the file.
#[derive(Debug, Clone)]
pub struct Image {
    gray: GrayImage,
}

impl Image {
    /// Columns.
    pub const fn width(&self) -> u32 {
        self.gray.width()
    }

    /// Rows.
    pub const fn height(&self) -> u32 {
        self.gray.height()
    }

    /// Its gray samples.
    pub const fn gray(&self) -> &GrayImage {
        &self.gray
    }

    /// The same image at most `max_side` pixels wide and high, see [`GrayImage::limited`].
    #[must_use]
    pub fn limited(self, max_side: u32) -> Self {
        Self { gray: self.gray.limited(max_side) }
    }
}

impl From<GrayImage> for Image {
    fn from(gray: GrayImage) -> Self {
        Self { gray }
    }
}
