//! Images and masks from Python: files, or numpy arrays.

use std::path::{Path, PathBuf};

use numpy::ndarray::{ArrayView2, ArrayView3};
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use veiloc_features::{
    DisplayTurn, FeatureError, GrayImage, Image, Mask, display_turn, guessed_camera_of, load_gray, load_mask,
};
use veiloc_obfuscation::KnownCamera;
use veiloc_protocol::FocalKnowledge;

use crate::errors::{BindingError, Result};

/// An image file that was not read yet, or an array.
pub(crate) enum ImageInput {
    File(PathBuf),
    Array(GrayImage),
}

impl ImageInput {
    /// A path, or an array `[H, W]` or `[H, W, 3]` of bytes, or `[H, W]` of floats in [0, 1].
    pub(crate) fn from_python(image: &Bound<'_, PyAny>) -> Result<Self> {
        if let Ok(path) = image.extract::<PathBuf>() {
            return Ok(Self::File(path));
        }
        let gray = if let Ok(array) = image.extract::<PyReadonlyArray2<'_, u8>>() {
            let (height, width, samples) = bytes2(array.as_array())?;
            GrayImage::from_luma8(width, height, &samples)
        } else if let Ok(array) = image.extract::<PyReadonlyArray3<'_, u8>>() {
            let (height, width, samples) = bytes3(array.as_array())?;
            GrayImage::from_rgb8(width, height, &samples)
        } else if let Ok(array) = image.extract::<PyReadonlyArray2<'_, f32>>() {
            let view = array.as_array();
            // Filters that sharpen go a little beyond white.
            if let Some(bright) = view.iter().find(|value| **value > 2.0) {
                return Err(BindingError::input(format_args!(
                    "image: an array of float32 must be in [0, 1], and has {bright}; divide it by its largest possible value, such as 255"
                )));
            }
            GrayImage::new(side(view.ncols())?, side(view.nrows())?, view.iter().copied().collect())
        } else {
            return Err(BindingError::input(
                "image: must be a path, an array [H, W] or [H, W, 3] of uint8 (red, green, blue), or [H, W] of float32 in [0, 1]",
            ));
        };
        Ok(Self::Array(gray?))
    }

    /// Name of the image in messages.
    pub(crate) fn name(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Array(_) => Path::new("the array"),
        }
    }

    /// The camera from the focal length in the file's EXIF data.
    pub(crate) fn exif_camera(&self) -> Result<KnownCamera> {
        const REMEDY: &str = "pass camera=, or camera=\"unknown\" to have the focal length estimated";
        match self {
            Self::File(path) => KnownCamera::from_exif(path).map_err(|error| match error {
                FeatureError::NoFocal { path, reason } => {
                    BindingError::image(format_args!("{}: {reason}; {REMEDY}", path.display()))
                }
                error => error.into(),
            }),
            Self::Array(_) => {
                Err(BindingError::input(format_args!("camera: an array has no EXIF; {REMEDY}")))
            }
        }
    }

    /// A default camera for the size of the image, with an unknown focal length.
    pub(crate) fn guessed_camera(&self) -> Result<KnownCamera> {
        match self {
            Self::File(path) => Ok(KnownCamera::guessed(path)?),
            Self::Array(gray) => {
                let intrinsics = guessed_camera_of(self.name(), (gray.width(), gray.height()))?;
                Ok(KnownCamera { intrinsics, focal: FocalKnowledge::Unknown })
            }
        }
    }

    /// What a viewer does to the image before it displays it, by its EXIF orientation.
    pub(crate) fn display_turn(&self) -> Option<DisplayTurn> {
        match self {
            Self::File(path) => display_turn(path),
            Self::Array(_) => None,
        }
    }

    /// The pixels, without those that the mask hides.
    pub(crate) fn load(&self, mask: Option<&Mask>) -> Result<Image> {
        let gray = match self {
            Self::File(path) => load_gray(path)?,
            Self::Array(gray) => gray.clone(),
        };
        let image = Image::from(gray).named(self.name());
        Ok(match mask {
            Some(mask) => image.without(mask)?,
            None => image,
        })
    }
}

/// A mask: a file in which black hides, or an array `[H, W]` of bool in which True hides.
pub(crate) fn mask_of(mask: &Bound<'_, PyAny>) -> Result<Mask> {
    if let Ok(path) = mask.extract::<PathBuf>() {
        return Ok(load_mask(&path)?);
    }
    let refused =
        |_| BindingError::input("mask: must be a path, or an array [H, W] of bool in which True hides");
    let array = mask.extract::<PyReadonlyArray2<'_, bool>>().map_err(refused)?;
    let view = array.as_array();
    Ok(Mask::new(side(view.ncols())?, side(view.nrows())?, |x, y| view[[y as usize, x as usize]])?)
}

fn side(length: usize) -> Result<u32> {
    u32::try_from(length).map_err(|_| BindingError::input("image: too large"))
}

fn bytes2(view: ArrayView2<'_, u8>) -> Result<(u32, u32, Vec<u8>)> {
    Ok((side(view.nrows())?, side(view.ncols())?, view.iter().copied().collect()))
}

fn bytes3(view: ArrayView3<'_, u8>) -> Result<(u32, u32, Vec<u8>)> {
    let (height, width, channels) = view.dim();
    if channels != 3 {
        return Err(BindingError::input(format_args!(
            "image: must be [H, W, 3], not [{height}, {width}, {channels}]"
        )));
    }
    Ok((side(height)?, side(width)?, view.iter().copied().collect()))
}
