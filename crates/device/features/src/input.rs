//! What an extractor is given: one image in memory.

use crate::{FeatureError, GrayImage, Mask};

/// An image as an extractor sees it: samples, and nothing else of the file.
#[derive(Debug, Clone)]
pub struct Image {
    gray: GrayImage,
    /// What was hidden of it, at the size it had then.
    hidden: Option<Mask>,
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

    /// The same image with what the mask hides replaced ([`GrayImage::without`]): whoever is given the image sees nothing of it.
    /// What is extracted from it holds no keypoint that looks there ([`crate::extract_loaded`]).
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] for a mask of another size; [`FeatureError::HidesAll`] where it leaves nothing of what an
    /// earlier mask left.
    pub fn without(self, mask: &Mask) -> Result<Self, FeatureError> {
        let hidden = match &self.hidden {
            Some(hidden) => hidden.and(mask)?,
            None => mask.clone(),
        };
        Ok(Self { gray: self.gray.without(&hidden)?, hidden: Some(hidden) })
    }

    /// What was hidden of it.
    pub(crate) const fn hidden(&self) -> Option<&Mask> {
        self.hidden.as_ref()
    }

    /// The same image at most `max_side` pixels wide and high, see [`GrayImage::limited`].
    #[must_use]
    pub fn limited(self, max_side: u32) -> Self {
        Self { gray: self.gray.limited(max_side), ..self }
    }
}

impl From<GrayImage> for Image {
    fn from(gray: GrayImage) -> Self {
        Self { gray, hidden: None }
    }
}
