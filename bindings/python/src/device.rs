//! The device's road: extract, obfuscate, seal.

use numpy::{IntoPyArray, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_features::{Extractors, Features, Limits, Mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{
    DeviceLimits, KnownCamera, SealOptions, audit::obfuscate_points, device_rng, extract_loaded,
};
use veiloc_pose::Stop;
use veiloc_protocol::{AngleBits, CoarseGravity, FocalKnowledge, Observations, Scheme, SealedQuery};

use crate::arrays;
use crate::camera::camera_of;
use crate::errors::{Fault, Result};
use crate::images::{Given, mask_of};
use crate::profile::Profile;
use crate::waiting::released;

/// Keypoints and descriptors of an image.
///
/// Args:
///     image: a path, or an array `[H, W]` or `[H, W, 3]` of uint8 (red, green, blue), or `[H, W]` of float32 in [0, 1].
///     features: `"compact"` or `"sift"`.
///     max_keypoints: most keypoints, strongest first.
///     max_image_side: larger images are made smaller first, pixels.
///     mask: a path (black hides) or an array `[H, W]` of bool (True hides): nothing there is looked at.
///
/// Returns:
///     `keypoints` `[N, 2]` pixels (the first pixel's centre is (0.5, 0.5)), `descriptors` `[N, D]` uint8, `scales` `[N]`
///     pixels, `orientations` `[N]` radians, `responses` `[N]`, `image_size` `[2]` (width, height).
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
    let (image, mask) = (Given::of(image)?, mask.map(mask_of).transpose()?);
    let extractors = Extractors::default();
    let extractor = extractors.named(features)?;
    let limits = Limits { max_keypoints, max_side: max_image_side };
    let extracted = released(py, &Stop::default(), || -> Result<_> {
        let loaded = image.load(mask.as_ref())?;
        Ok(veiloc_features::extract_loaded(loaded, image.name(), None, extractor, limits)?)
    })??;
    let (width, height) = extracted.size_in_file;
    let found: Features = extracted.features_in_file();
    let (count, dim) = (found.keypoints.len(), found.descriptors.kind().dim());
    let told = PyDict::new(py);
    let of = |value: fn(&veiloc_features::Keypoint) -> f32| -> Vec<f32> {
        found.keypoints.iter().map(value).collect()
    };
    told.set_item("keypoints", arrays::matrix(py, found.keypoints.iter().map(|k| [k.pixel.u, k.pixel.v]))?)?;
    told.set_item("scales", of(|k| k.scale).into_pyarray(py))?;
    told.set_item("orientations", of(|k| k.orientation).into_pyarray(py))?;
    told.set_item("responses", of(|k| k.response).into_pyarray(py))?;
    let bytes = found.descriptors.as_bytes().to_vec();
    let columns = bytes.len().checked_div(count).unwrap_or(dim);
    told.set_item("descriptors", bytes.into_pyarray(py).reshape([count, columns])?)?;
    told.set_item("image_size", (width, height))?;
    Ok(told)
}

/// What a scheme tells of keypoints: the lines that would be sent of them, in their order. For experiments; a device seals.
///
/// Args:
///     points2d: `[N, 2]` pixels of an image without distortion.
///     width, height: of the image, pixels.
///     scheme: `"dcl"` (and its layouts), `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides nothing.
///     angle_bits: bits of an angle.
///     seed: of the generator.
///
/// Returns:
///     `kind` and its arrays: `"anchored"` with `anchors` `[N]`, `angles` `[N]` and `layout_focal`; `"lines"` with `lines` `[N, 3]`;
///     `"either"` with `lines` `[N, 2, 3]`, of which one is right; `"points"` with `points` `[N, 2]`.
///
/// Raises:
///     QueryError: an unknown scheme, or a point that is not finite.
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
    let told = PyDict::new(py);
    let coefficients = |line: &veiloc_geometry::PixelLine| -> [f64; 3] { (*line.coefficients()).into() };
    match sent {
        Observations::Points(points) => {
            told.set_item("kind", "points")?;
            told.set_item("points", arrays::matrix(py, points.iter().map(|p| [p.u, p.v]))?)?;
        }
        Observations::Lines(lines) => {
            told.set_item("kind", "lines")?;
            told.set_item("lines", arrays::matrix(py, lines.iter().map(coefficients))?)?;
        }
        Observations::EitherLine(pairs) => {
            told.set_item("kind", "either")?;
            let flat: Vec<[f64; 3]> = pairs.iter().flatten().map(coefficients).collect();
            told.set_item("lines", arrays::matrix(py, flat.into_iter())?.reshape([pairs.len(), 2, 3])?)?;
        }
        Observations::Anchored { pencils, lines } => {
            told.set_item("kind", "anchored")?;
            told.set_item("layout_focal", pencils.camera().mean_focal())?;
            let anchors: Vec<i64> = lines.iter().map(|l| l.anchor.index() as i64).collect();
            let angles: Vec<f64> = lines.iter().map(|l| l.angle).collect();
            told.set_item("anchors", anchors.into_pyarray(py))?;
            told.set_item("angles", angles.into_pyarray(py))?;
        }
    }
    Ok(told)
}

/// What a device decides when it seals; all of it, whatever a profile says.
pub(crate) struct Wishes<'a, 'py> {
    pub(crate) scheme: &'a str,
    pub(crate) max_keypoints: Option<usize>,
    pub(crate) angle_bits: u8,
    pub(crate) gravity: Option<&'a Bound<'py, PyAny>>,
    pub(crate) focal: Option<&'a str>,
}

/// One image, ready to be sealed: what to extract from, its camera, and the options.
pub(crate) struct Ready {
    image: Given,
    mask: Option<Mask>,
    camera: Intrinsics,
    pub(crate) options: SealOptions,
}

impl Ready {
    pub(crate) fn new(
        image: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
        wishes: &Wishes<'_, '_>,
    ) -> Result<Self> {
        let image = Given::of(image)?;
        let known = match camera {
            None => KnownCamera::from_exif(image.file()?)?,
            Some(word) if word.extract::<String>().is_ok_and(|word| word == "unknown") => {
                KnownCamera::guessed(image.file()?)?
            }
            Some(camera) => KnownCamera::calibrated(camera_of(camera)?),
        };
        let focal = match wishes.focal {
            Some(word) => word.parse::<FocalKnowledge>().map_err(Fault::input)?,
            None => known.focal,
        };
        let scheme: Scheme = wishes.scheme.parse()?;
        let options = match scheme {
            Scheme::Points => SealOptions::unprotected_points(),
            hidden => SealOptions::new(hidden)?,
        };
        let gravity = wishes.gravity.map(coarse_gravity).transpose()?;
        let options = options
            .with_angle_bits(AngleBits::new(wishes.angle_bits)?)
            .with_focal(focal)
            .with_gravity(gravity);
        let options = match wishes.max_keypoints {
            Some(most) => options.with_max_keypoints(most),
            None => options,
        };
        Ok(Self { image, mask: mask.map(mask_of).transpose()?, camera: known.intrinsics, options })
    }

    /// Features of the image as the profile asks for them, and the camera they are in.
    pub(crate) fn extracted(&self, profile: &Profile) -> Result<(Features, Intrinsics)> {
        let image = self.image.load(self.mask.as_ref())?;
        Ok(extract_loaded(image, self.image.name(), &self.camera, &profile.0, &self.options)?)
    }
}

/// Down as the device felt it, three numbers and perhaps a deviation in degrees.
fn coarse_gravity(gravity: &Bound<'_, PyAny>) -> Result<CoarseGravity> {
    let numbers = arrays::numbers::<f64>("gravity", gravity)?;
    match *numbers.as_slice() {
        [x, y, z] => Ok(CoarseGravity::new([x, y, z], CoarseGravity::PHONE_SD_DEG)?),
        [x, y, z, sd] => Ok(CoarseGravity::new([x, y, z], sd)?),
        _ => Err(Fault::input("gravity: [x, y, z] or [x, y, z, degrees] is needed")),
    }
}

/// Seals one image: all that leaves a device. Everything random comes from the operating system; an image is sealed once.
///
/// Several images of one place belong in one `Session`.
///
/// Args:
///     image: a path, or an array as of `extract`.
///     camera: a dictionary or text as of `estimate_absolute_pose`; None takes the focal length of the file's EXIF, `"unknown"`
///         guesses it.
///     profile: the map's.
///     scheme: `"dcl"` and its layouts, `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides nothing.
///     max_keypoints: most rows that are sent. Default: as many as the profile asks for, 2048 at most.
///     angle_bits: bits of an angle.
///     gravity: `[x, y, z]` or `[x, y, z, degrees]`, down as the device felt it in the camera's axes, and its deviation (2).
///     focal: `"calibrated"`, `"exif"` or `"unknown"`. Default: by where the camera comes from.
///     mask: a path (black hides) or an array `[H, W]` of bool (True hides).
///
/// Returns:
///     The bytes of the sealed query.
///
/// Raises:
///     ImageError: the image or the mask cannot be used.
///     QueryError: the profile asks for more than this device gives, or a scheme is unknown.
///     InputError: other arguments.
#[pyfunction]
#[pyo3(signature = (image, camera, profile, *, scheme="dcl", max_keypoints=None, angle_bits=12, gravity=None, focal=None, mask=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn seal<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    camera: Option<&Bound<'py, PyAny>>,
    profile: &Profile,
    scheme: &str,
    max_keypoints: Option<usize>,
    angle_bits: u8,
    gravity: Option<&Bound<'py, PyAny>>,
    focal: Option<&str>,
    mask: Option<&Bound<'py, PyAny>>,
) -> Result<Bound<'py, PyBytes>> {
    let wishes = Wishes { scheme, max_keypoints, angle_bits, gravity, focal };
    let ready = Ready::new(image, camera, mask, &wishes)?;
    let bytes = released(py, &Stop::default(), || -> Result<Vec<u8>> {
        let (features, camera) = ready.extracted(profile)?;
        let query: SealedQuery =
            veiloc_obfuscation::seal(features, &camera, &profile.0, &ready.options, &mut device_rng()?)?;
        Ok(query.encode())
    })??;
    Ok(PyBytes::new(py, &bytes))
}

/// What a sealed query says of itself: scheme, rows, bytes, profile; nothing of its content.
///
/// Raises:
///     QueryError: the bytes are no sealed query.
#[pyfunction]
pub(crate) fn describe_query<'py>(py: Python<'py>, query: &[u8]) -> Result<Bound<'py, PyDict>> {
    let sealed = SealedQuery::decode(query)?;
    let told = PyDict::new(py);
    told.set_item("scheme", sealed.scheme().to_string())?;
    told.set_item("rows", sealed.len())?;
    told.set_item("bytes", query.len())?;
    told.set_item("profile", sealed.profile_id().to_string())?;
    let camera = sealed.camera();
    told.set_item("camera_size", (camera.width, camera.height))?;
    Ok(told)
}

/// How far this device follows a profile.
#[pyfunction]
pub(crate) fn device_limits(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let (limits, told) = (DeviceLimits::default(), PyDict::new(py));
    told.set_item("max_keypoints", limits.max_keypoints)?;
    told.set_item("max_image_side", limits.max_image_side)?;
    told.set_item("max_vocabulary_words", limits.max_vocabulary_words)?;
    Ok(told)
}
