//! Images and masks from Python: files, or numpy arrays.

use std::path::{Path, PathBuf};

use numpy::ndarray::{Array2, ArrayView2, ArrayView3};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use veiloc_features::{
    ColourImage, DisplayTurn, FeatureError, GrayImage, Image, Mask, PersonSegmenter, display_turn,
    guessed_camera_of, load_colour, load_gray, load_mask,
};
use veiloc_geometry::QuarterTurns;
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

/// The people of an image, for `mask=` of `extract` and `Sealer.extract`.
///
/// Args:
///     image: a path, or an array `[H, W, 3]` of uint8 (red, green, blue), upright.
///     network: path of `selfie_segmentation.tflite` of MediaPipe (Apache-2.0, in the npm package
///         `@mediapipe/selfie_segmentation`); veiloc includes none.
///     margin: how far beyond the people is hidden, too, as a share of the image.
///
/// Returns:
///     `[H, W]` bool, True where a person was found, or `None` when nobody was. What the network misses is not hidden.
///
/// Raises:
///     InputError: the image is of another kind.
///     ImageError: the image or the network cannot be used, or the people fill the whole image.
#[pyfunction]
#[pyo3(signature = (image, network, *, margin=0.02))]
pub(crate) fn people_mask<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    network: PathBuf,
    margin: f32,
) -> Result<Option<Bound<'py, PyArray2<bool>>>> {
    let (image, turn) = if let Ok(path) = image.extract::<PathBuf>() {
        (load_colour(&path)?, display_turn(&path).map_or(0, |turn| turn.degrees))
    } else if let Ok(array) = image.extract::<PyReadonlyArray3<'_, u8>>() {
        let (height, width, samples) = bytes3(array.as_array())?;
        (ColourImage::new(width, height, samples)?, 0)
    } else {
        return Err(BindingError::input(
            "image: must be a path, or an array [H, W, 3] of uint8 (red, green, blue)",
        ));
    };
    let file = std::fs::read(&network).map_err(|source| FeatureError::Read { path: network, source })?;
    let segmenter = PersonSegmenter::read(&file)?;
    let turns = QuarterTurns::from_degrees(i32::from(turn)).unwrap_or_default();
    let mask = py.detach(|| segmenter.mask(&image, turns, margin))?;
    let size = (image.height() as usize, image.width() as usize);
    Ok(mask.map(|mask| Array2::from_shape_fn(size, |(y, x)| mask.hides(x as u32, y as u32)).into_pyarray(py)))
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
