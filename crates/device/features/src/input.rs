//! The input of an extractor: one image in memory.

use std::path::{Path, PathBuf};

use veiloc_geometry::{QuarterTurns, Stop};

use crate::{CameraFrame, FeatureError, GrayImage, Mask, load_gray};

/// An image for extractors: samples, and no metadata.
#[derive(Debug, Clone)]
pub struct Image {
    /// The file it was read from, or a name for messages.
    name: PathBuf,
    gray: GrayImage,
    turns: QuarterTurns,
    /// The mask of its hidden pixels, at the size of the image before scaling.
    hidden: Option<Mask>,
    stop: Stop,
}

impl Image {
    /// Reads an image file as it is stored.
    ///
    /// # Errors
    /// As [`load_gray`].
    pub fn open(path: &Path) -> Result<Self, FeatureError> {
        Ok(Self::from(load_gray(path)?).named(path))
    }

    /// The image with another name for messages: the file that its samples came from.
    #[must_use]
    pub fn named(self, name: impl Into<PathBuf>) -> Self {
        Self { name: name.into(), ..self }
    }

    /// The file it was read from, or a name for messages.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// How the samples are turned relative to the camera ([`CameraFrame::turned`]): the camera of the image is the given
    /// one, turned as much.
    pub const fn turns(&self) -> QuarterTurns {
        self.turns
    }

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
        let (name, turns) = (PathBuf::from("the image"), QuarterTurns::NONE);
        Self { name, gray, turns, hidden: None, stop: Stop::default() }
    }
}

/// What the frame hides ([`CameraFrame::hiding`]) is replaced, as [`Image::without`] does.
impl From<&CameraFrame<'_>> for Image {
    fn from(frame: &CameraFrame<'_>) -> Self {
        let hidden = frame.hidden().map(|mask| mask.turned(frame.turns()));
        let gray = match &hidden {
            Some(mask) => frame.gray().filled_under(mask),
            None => frame.gray(),
        };
        Self { turns: frame.turns(), hidden, ..Self::from(gray).named("the frame") }
    }
}
