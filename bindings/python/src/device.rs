//! The device side: features of an image, bare obfuscation for experiments, and facts about queries.

use numpy::{IntoPyArray, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_features::{Extractors, Features, Limits};
use veiloc_obfuscation::{DeviceLimits, audit::obfuscate_points};
use veiloc_pose::Stop;
use veiloc_protocol::{AngleBits, Observations, QueryContent, Scheme, SealedQuery};

use crate::arrays;
use crate::blocking::interruptible;
use crate::errors::Result;
use crate::images::{ImageInput, mask_of};

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
    let stop = Stop::default();
    let extracted = interruptible(py, &stop, || -> Result<_> {
        let loaded = image.load(mask.as_ref())?.with_stop(&stop);
        Ok(veiloc_features::extract_loaded(loaded, None, extractor, limits)?)
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

/// Obfuscates keypoints under a scheme, in their order. For experiments only; a device has a `Sealer`.
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

/// Reads the header of a sealed query: scheme, rows, bytes, profile, pack, camera size; no keypoints and no descriptors.
///
/// `pack` is the id of the pack in which the query sends matches; None for a query with descriptors.
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
    let pack = match sealed.content() {
        QueryContent::Described { .. } => None,
        QueryContent::Matched { pack, .. } => Some(pack.to_string()),
    };
    dict.set_item("pack", pack)?;
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
    dict.set_item("max_pack_rows", limits.max_pack_rows)?;
    Ok(dict)
}
