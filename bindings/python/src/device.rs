//! The device side: extract features, obfuscate them, seal a query.

use std::ffi::CString;
use std::path::Path;

use numpy::{IntoPyArray, PyArrayMethods as _};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_features::{DisplayTurn, Extractors, Features, Limits, Mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{
    DeviceLimits, KnownCamera, SealOptions, audit::obfuscate_points, device_rng, extract_loaded,
};
use veiloc_pose::Stop;
use veiloc_protocol::{AngleBits, CoarseGravity, FocalKnowledge, Observations, Scheme, SealedQuery};

use crate::arrays;
use crate::blocking::interruptible;
use crate::camera::camera_of;
use crate::errors::{BindingError, Result};
use crate::images::{ImageInput, mask_of};
use crate::profile::Profile;

/// Keypoints and descriptors of an image.
///
/// Args:
///     image: a path, or an array `[H, W]` or `[H, W, 3]` of uint8 (red, green, blue), or `[H, W]` of float32 (0 to 1).
///     features: `"compact"` or `"sift"`.
///     max_keypoints: most keypoints to return, strongest first.
///     max_image_side: larger images are scaled down to this side first, pixels.
///     mask: a path (black hides) or an array `[H, W]` of bool (True hides); hidden pixels are not used.
///
/// Returns:
///     `keypoints` `[N, 2]` pixels (the first pixel's centre is (0.5, 0.5)), `descriptors` `[N, D]` uint8, `scales`
///     `[N]` pixels, `orientations` `[N]` radians, `responses` `[N]`, `image_size` `[2]` (width, height).
///
/// Raises:
///     ImageError: the image or the mask cannot be used, or `features` is unknown.
#[pyfunction]
#[pyo3(signature = (image, *, features="compact", max_keypoints=2048, max_image_side=2048, mask=None))]
pub(crate) fn extract<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    features: &str,
    max_keypoints: usize,
    max_image_side: u32,
    mask: Option<&Bound<'py, PyAny>>,
) -> Result<Bound<'py, PyDict>> {
    let (image, mask) = (ImageInput::from_python(image)?, mask.map(mask_of).transpose()?);
    let extractors = Extractors::default();
    let extractor = extractors.named(features)?;
    let limits = Limits { max_keypoints, max_side: max_image_side };
    let extracted = interruptible(py, &Stop::default(), || -> Result<_> {
        let loaded = image.load(mask.as_ref())?;
        Ok(veiloc_features::extract_loaded(loaded, image.name(), None, extractor, limits)?)
    })??;
    let (width, height) = extracted.size_in_file;
    let found: Features = extracted.features_in_file();
    let (count, dim) = (found.keypoints.len(), found.descriptors.kind().dim());
    let dict = PyDict::new(py);
    let of = |value: fn(&veiloc_features::Keypoint) -> f32| -> Vec<f32> {
        found.keypoints.iter().map(value).collect()
    };
    dict.set_item("keypoints", arrays::matrix(py, found.keypoints.iter().map(|k| [k.pixel.u, k.pixel.v]))?)?;
    dict.set_item("scales", of(|k| k.scale).into_pyarray(py))?;
    dict.set_item("orientations", of(|k| k.orientation).into_pyarray(py))?;
    dict.set_item("responses", of(|k| k.response).into_pyarray(py))?;
    let bytes = found.descriptors.as_bytes().to_vec();
    let columns = bytes.len().checked_div(count).unwrap_or(dim);
    dict.set_item("descriptors", bytes.into_pyarray(py).reshape([count, columns])?)?;
    dict.set_item("image_size", (width, height))?;
    Ok(dict)
}

/// Obfuscates keypoints under a scheme, in their order. For experiments only; a device calls `seal`.
///
/// Args:
///     points2d: `[N, 2]` pixels of an image without distortion.
///     width, height: size of the image, pixels.
///     scheme: `"dcl"` (and its layouts), `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides
///         nothing.
///     angle_bits: bits of each quantized angle.
///     seed: seed of the random generator.
///
/// Returns:
///     A dictionary with `kind` and its arrays: `"anchored"` with `anchors` `[N]`, `angles` `[N]` and `layout_focal`;
///     `"lines"` with `lines` `[N, 3]`; `"either"` with `lines` `[N, 2, 3]`, one of the two is right; `"points"` with
///     `points` `[N, 2]`.
///
/// Raises:
///     QueryError: the scheme is unknown, or a point is not finite.
#[pyfunction]
#[pyo3(signature = (points2d, width, height, scheme="dcl", *, angle_bits=12, seed=0))]
pub(crate) fn obfuscate<'py>(
    py: Python<'py>,
    points2d: &Bound<'py, PyAny>,
    width: u32,
    height: u32,
    scheme: &str,
    angle_bits: u8,
    seed: u64,
) -> Result<Bound<'py, PyDict>> {
    let pixels = arrays::pixels("points2d", points2d)?;
    let scheme: Scheme = scheme.parse()?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let sent = obfuscate_points(&pixels, width, height, &scheme, AngleBits::new(angle_bits)?, &mut rng)?;
    let dict = PyDict::new(py);
    let coefficients = |line: &veiloc_geometry::PixelLine| -> [f64; 3] { (*line.coefficients()).into() };
    match sent {
        Observations::Points(points) => {
            dict.set_item("kind", "points")?;
            dict.set_item("points", arrays::matrix(py, points.iter().map(|p| [p.u, p.v]))?)?;
        }
        Observations::Lines(lines) => {
            dict.set_item("kind", "lines")?;
            dict.set_item("lines", arrays::matrix(py, lines.iter().map(coefficients))?)?;
        }
        Observations::EitherLine(pairs) => {
            dict.set_item("kind", "either")?;
            let flat: Vec<[f64; 3]> = pairs.iter().flatten().map(coefficients).collect();
            dict.set_item("lines", arrays::matrix(py, flat.into_iter())?.reshape([pairs.len(), 2, 3])?)?;
        }
        Observations::Anchored { pencils, lines } => {
            dict.set_item("kind", "anchored")?;
            dict.set_item("layout_focal", pencils.camera().mean_focal())?;
            let anchors: Vec<i64> = lines.iter().map(|l| l.anchor.index() as i64).collect();
            let angles: Vec<f64> = lines.iter().map(|l| l.angle).collect();
            dict.set_item("anchors", anchors.into_pyarray(py))?;
            dict.set_item("angles", angles.into_pyarray(py))?;
        }
    }
    Ok(dict)
}

/// The options that the device decides when it seals. A profile cannot change them.
pub(crate) struct SealArguments<'a, 'py> {
    pub(crate) scheme: &'a str,
    pub(crate) max_keypoints: Option<usize>,
    pub(crate) max_image_side: Option<u32>,
    pub(crate) angle_bits: u8,
    pub(crate) gravity: Option<&'a Bound<'py, PyAny>>,
    pub(crate) focal: Option<&'a str>,
}

/// One image to seal, with its mask, its camera and the options.
pub(crate) struct SealInput {
    image: ImageInput,
    mask: Option<Mask>,
    camera: Intrinsics,
    pub(crate) options: SealOptions,
}

impl SealInput {
    pub(crate) fn new(
        image: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
        arguments: &SealArguments<'_, '_>,
    ) -> Result<Self> {
        let py = image.py();
        let image = ImageInput::from_python(image)?;
        let known = match camera {
            None => image.exif_camera()?,
            Some(text) if text.extract::<String>().is_ok_and(|text| text == "unknown") => {
                image.guessed_camera()?
            }
            Some(camera) => KnownCamera::calibrated(camera_of(camera)?),
        };
        if known.focal != FocalKnowledge::Calibrated
            && let Some(turn) = image.display_turn()
        {
            warn_of_turn(py, image.name(), turn)?;
        }
        let focal = match arguments.focal {
            Some(name) => name.parse::<FocalKnowledge>().map_err(BindingError::input)?,
            None => known.focal,
        };
        let scheme: Scheme = arguments.scheme.parse()?;
        let options = match scheme {
            Scheme::Points => SealOptions::unprotected_points(),
            hidden => SealOptions::new(hidden)?,
        };
        let gravity = arguments.gravity.map(coarse_gravity).transpose()?;
        let options = options
            .with_angle_bits(AngleBits::new(arguments.angle_bits)?)
            .with_focal(focal)
            .with_gravity(gravity);
        let options = match arguments.max_keypoints {
            Some(most) => options.with_max_keypoints(most),
            None => options,
        };
        let mut limits = DeviceLimits::default();
        limits.max_image_side = arguments.max_image_side.unwrap_or(limits.max_image_side);
        let options = options.with_limits(limits);
        Ok(Self { image, mask: mask.map(mask_of).transpose()?, camera: known.intrinsics, options })
    }

    /// Extracts the features that the profile requests; returns them with the camera of their pixels.
    pub(crate) fn extracted(&self, profile: &Profile) -> Result<(Features, Intrinsics)> {
        let image = self.image.load(self.mask.as_ref())?;
        Ok(extract_loaded(image, self.image.name(), &self.camera, &profile.0, &self.options)?)
    }
}

/// Warns that the pose will be that of the stored image: with a given camera the caller knows its size.
fn warn_of_turn(py: Python<'_>, image: &Path, turn: DisplayTurn) -> Result<()> {
    let message = format!(
        "{} is {turn} for display, because of its EXIF orientation. It is sealed as it is stored, and its pose is that of the \
         stored image; turn the pixels first for the pose of the image as it is displayed",
        image.display()
    );
    let message = CString::new(message).map_err(BindingError::other)?;
    Ok(PyErr::warn(py, &py.get_type::<PyUserWarning>(), &message, 1)?)
}

/// The measured down direction: three numbers, optionally followed by a standard deviation in degrees.
fn coarse_gravity(gravity: &Bound<'_, PyAny>) -> Result<CoarseGravity> {
    let numbers = arrays::numbers::<f64>("gravity", gravity)?;
    match *numbers.as_slice() {
        [x, y, z] => Ok(CoarseGravity::new([x, y, z], CoarseGravity::PHONE_SD_DEG)?),
        [x, y, z, sd] => Ok(CoarseGravity::new([x, y, z], sd)?),
        _ => Err(BindingError::input("gravity: must be [x, y, z] or [x, y, z, degrees]")),
    }
}

/// Seals one image into a query: only these bytes leave the device. Randomness comes from the operating system.
///
/// Seal each image once. For several images of the same scene use one `Session`.
///
/// Args:
///     image: a path, or an array as for `extract`.
///     camera: a dictionary or text as for `estimate_absolute_pose`; None reads the focal length from the file's EXIF,
///         `"unknown"` sends a guess, which localization corrects.
///     profile: profile of the map.
///     scheme: `"dcl"` and its layouts, `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides
///         nothing.
///     max_keypoints: most rows to send. Default: the number that the profile requests, at most 2048.
///     max_image_side: longest side to which the image is scaled down, pixels, whatever the profile requests; default
///         2048. The next smaller size of the device's list is used.
///     angle_bits: bits of each quantized angle.
///     gravity: `[x, y, z]` or `[x, y, z, degrees]`: measured down direction in the camera frame, and its standard
///         deviation (2). It is sent with the query.
///     focal: `"calibrated"`, `"exif"` or `"unknown"`. Default: follows from `camera`.
///     mask: a path (black hides) or an array `[H, W]` of bool (True hides).
///
/// Returns:
///     The bytes of the sealed query.
///
/// Raises:
///     ImageError: the image or the mask cannot be used.
///     QueryError: the profile requests more than this device sends, or the scheme is unknown.
///     InputError: another argument is invalid.
#[pyfunction]
#[pyo3(signature = (image, camera, profile, *, scheme="dcl", max_keypoints=None, max_image_side=None, angle_bits=12, gravity=None, focal=None, mask=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn seal<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    camera: Option<&Bound<'py, PyAny>>,
    profile: &Profile,
    scheme: &str,
    max_keypoints: Option<usize>,
    max_image_side: Option<u32>,
    angle_bits: u8,
    gravity: Option<&Bound<'py, PyAny>>,
    focal: Option<&str>,
    mask: Option<&Bound<'py, PyAny>>,
) -> Result<Bound<'py, PyBytes>> {
    let arguments = SealArguments { scheme, max_keypoints, max_image_side, angle_bits, gravity, focal };
    let input = SealInput::new(image, camera, mask, &arguments)?;
    let bytes = interruptible(py, &Stop::default(), || -> Result<Vec<u8>> {
        let (features, camera) = input.extracted(profile)?;
        let query: SealedQuery =
            veiloc_obfuscation::seal(features, &camera, &profile.0, &input.options, &mut device_rng()?)?;
        Ok(query.encode())
    })??;
    Ok(PyBytes::new(py, &bytes))
}

/// Reads the header of a sealed query: scheme, rows, bytes, profile, camera size; no keypoints and no descriptors.
///
/// Raises:
///     QueryError: the bytes are not a sealed query.
#[pyfunction]
pub(crate) fn describe_query<'py>(py: Python<'py>, query: &[u8]) -> Result<Bound<'py, PyDict>> {
    let sealed = SealedQuery::decode(query)?;
    let dict = PyDict::new(py);
    dict.set_item("scheme", sealed.scheme().to_string())?;
    dict.set_item("rows", sealed.len())?;
    dict.set_item("bytes", query.len())?;
    dict.set_item("profile", sealed.profile_id().to_string())?;
    let camera = sealed.camera();
    dict.set_item("camera_size", (camera.width, camera.height))?;
    Ok(dict)
}

/// Upper limits that this device applies to what a profile requests.
#[pyfunction]
pub(crate) fn device_limits(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let (limits, dict) = (DeviceLimits::default(), PyDict::new(py));
    dict.set_item("max_keypoints", limits.max_keypoints)?;
    dict.set_item("max_image_side", limits.max_image_side)?;
    dict.set_item("max_vocabulary_words", limits.max_vocabulary_words)?;
    Ok(dict)
}
