//! The input of an extractor: one image in memory.

use veiloc_geometry::Stop;

use crate::{FeatureError, GrayImage, Mask};

/// An image for extractors: samples, and no metadata.
#[derive(Debug, Clone)]
pub struct Image {
    gray: GrayImage,
    /// The mask of its hidden pixels, at the size of the image before scaling.
    hidden: Option<Mask>,
    stop: Stop,
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

    /// The image with its hidden pixels replaced ([`GrayImage::without`]): no extractor can read them. Features
    /// extracted from it have no keypoint whose window touches the mask ([`crate::extract_loaded`]).
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] for a mask of another size; [`FeatureError::HidesAll`] when it hides all pixels that
    /// an earlier mask left visible.
    pub fn without(self, mask: &Mask) -> Result<Self, FeatureError> {
        let hidden = match &self.hidden {
            Some(hidden) => hidden.and(mask)?,
            None => mask.clone(),
        };
        Ok(Self { gray: self.gray.without(&hidden)?, hidden: Some(hidden), ..self })
    }

    /// The mask of its hidden pixels.
    pub(crate) const fn hidden(&self) -> Option<&Mask> {
        self.hidden.as_ref()
    }

    /// The image with a flag that stops its extraction.
    #[must_use]
    pub fn with_stop(self, stop: &Stop) -> Self {
        Self { stop: stop.clone(), ..self }
    }

    /// The flag. An extractor that takes long checks it, and gives [`FeatureError::Stopped`] once it is set.
    pub const fn stop(&self) -> &Stop {
        &self.stop
    }

    /// The image scaled down to at most `max_side` pixels wide and high, see [`GrayImage::limited`].
    #[must_use]
    pub fn limited(self, max_side: u32) -> Self {
        Self { gray: self.gray.limited(max_side), ..self }
    }
}

impl From<GrayImage> for Image {
    fn from(gray: GrayImage) -> Self {
        Self { gray, hidden: None, stop: Stop::default() }
    }
}
