//! The camera from a file's EXIF focal length, for uncalibrated images.
//!
//! Read only when a caller requests it, and no other metadata is read: no time, no location, no maker. The result is a
//! pinhole camera with its principal point in the middle. Damaged fields count as absent.
//!
//! # From EXIF to pixels
//! The first of these that the file has:
//! - `FocalLengthIn35mmFilm` `f`: by the diagonal, as camera makers define it (CIPA DCG-001),
//!   `f · √(w² + h²) / √(36² + 24²)`.
//! - `FocalLength` `f` (mm) with `FocalPlaneXResolution` (pixels per unit) and its unit: `f · resolution`, times the
//!   size of the file's image divided by the size at capture according to EXIF (for a scaled-down copy), times
//!   `DigitalZoomRatio` if present.
//!
//! The camera is for the stored pixels: the orientation is not applied, and neither formula depends on it.

use std::io::Cursor;
use std::path::Path;

use exif::{Error, Exif, In, Reader, Tag, Value};
use veiloc_geometry::{Intrinsics, QuarterTurns};

use crate::FeatureError;
use crate::load::{Header, header};
use crate::orientation::DisplayTurn;

/// Millimetres of 35 mm film's diagonal.
const FILM_DIAGONAL: f64 = 43.266_615_305_567_87;
/// Possible focal lengths relative to the longer side; others are errors in the metadata.
const POSSIBLE: std::ops::RangeInclusive<f64> = 0.1..=100.0;
/// Largest difference between the aspect ratios of the image and of EXIF before the image counts as cropped.
const CROPPED: f64 = 0.02;
/// A default that is seldom wrong by more than a factor of two: COLMAP's.
const GUESS: f64 = 1.2;

/// The camera of an image file from its EXIF data: a pinhole with its principal point in the middle.
///
/// # Errors
/// [`FeatureError::NoFocal`] with the reason why EXIF gives no focal length; [`FeatureError::Read`],
/// [`FeatureError::Decode`] or [`FeatureError::TooLarge`] when the file is not an image.
pub fn exif_camera(path: &Path) -> Result<Intrinsics, FeatureError> {
    let Header { size, metadata } = header(path)?;
    let no_focal = |reason| FeatureError::NoFocal { path: path.into(), reason };
    let metadata = metadata.ok_or_else(|| no_focal("it has no EXIF"))?;
    // Some writers leave the marker of the segment before the data.
    let data = metadata.strip_prefix(b"Exif\0\0").unwrap_or(&metadata).to_vec();
    let exif = whole_fields(Reader::new().continue_on_error(true).read_raw(data));
    let exif = exif.map_err(|_| no_focal("its EXIF is damaged"))?;
    let focal = focal_px(&exif, size).map_err(no_focal)?;
    camera(path, size, focal)
}

/// As [`exif_camera`], for a file in memory whose pixels another program decodes, such as a browser; `path` is its name in
/// messages.
///
/// `size` is that of the decoded image. It may be turned upright or scaled down: the focal length is that of its pixels.
///
/// # Errors
/// [`FeatureError::NoFocal`] with the reason why EXIF gives no focal length.
pub fn exif_camera_of(path: &Path, file: &[u8], size: (u32, u32)) -> Result<Intrinsics, FeatureError> {
    let no_focal = |reason| FeatureError::NoFocal { path: path.into(), reason };
    let exif =
        whole_fields(Reader::new().continue_on_error(true).read_from_container(&mut Cursor::new(file)));
    let exif = exif.map_err(|error| match error {
        Error::NotFound(_) => no_focal("it has no EXIF"),
        _ => no_focal("its EXIF is damaged"),
    })?;
    let focal = focal_px(&exif, size).map_err(no_focal)?;
    camera(path, size, focal)
}

/// How the image of a file in memory is turned for display, by its EXIF data; not at all when it has none. Mirroring is not
/// reported.
pub fn exif_turns_of(file: &[u8]) -> QuarterTurns {
    let exif = Reader::new().continue_on_error(true).read_from_container(&mut Cursor::new(file));
    let orientation = whole_fields(exif).ok().and_then(|exif| number(&exif, Tag::Orientation));
    orientation
        .and_then(|number| DisplayTurn::of_exif(number as u8))
        .map(DisplayTurn::turns)
        .unwrap_or_default()
}

/// What can be read: many writers spoil one field, or the link behind a directory, and other readers take the rest.
fn whole_fields(exif: Result<Exif, Error>) -> Result<Exif, Error> {
    exif.or_else(|error| error.distill_partial_result(|_| {}))
}

/// A default camera for an image of unknown origin: focal length 1.2 times the longer side.
///
/// # Errors
/// As [`exif_camera`], except for EXIF.
pub fn guessed_camera(path: &Path) -> Result<Intrinsics, FeatureError> {
    guessed_camera_of(path, header(path)?.size)
}

/// As [`guessed_camera`], for an image in memory of this width and height; `path` is its name in messages.
///
/// # Errors
/// [`FeatureError::NoFocal`] for an invalid size.
pub fn guessed_camera_of(path: &Path, size: (u32, u32)) -> Result<Intrinsics, FeatureError> {
    camera(path, size, GUESS * f64::from(size.0.max(size.1)))
}

fn camera(path: &Path, (width, height): (u32, u32), focal: f64) -> Result<Intrinsics, FeatureError> {
    let params = [focal, f64::from(width) / 2.0, f64::from(height) / 2.0];
    Intrinsics::new("SIMPLE_PINHOLE", width, height, &params).map_err(|_| {
        let reason = "its focal length is outside of the possible range";
        FeatureError::NoFocal { path: path.into(), reason }
    })
}

/// The focal length, pixels of an image of this size.
fn focal_px(exif: &Exif, (width, height): (u32, u32)) -> Result<f64, &'static str> {
    let (width, height) = (f64::from(width), f64::from(height));
    let longer = width.max(height);
    let taken = [Tag::PixelXDimension, Tag::PixelYDimension].map(|tag| number(exif, tag));
    let taken = match taken {
        [Some(w), Some(h)] => Some((w.max(h), w.min(h))),
        _ => None,
    };
    if let Some((long, short)) = taken {
        let own = longer / width.min(height);
        if ((long / short) / own - 1.0).abs() > CROPPED {
            return Err(
                "its aspect ratio differs from the one in EXIF, so it was cropped, and the focal length is \
                        not valid for the rest",
            );
        }
    }
    let of_film = number(exif, Tag::FocalLengthIn35mmFilm).map(|f| f * width.hypot(height) / FILM_DIAGONAL);
    let focal = of_film.or_else(|| {
        let resolution = number(exif, Tag::FocalPlaneXResolution)?;
        // Inches by default, as the standard defines.
        let unit = match number(exif, Tag::FocalPlaneResolutionUnit).unwrap_or(2.0) as u32 {
            2 => 25.4,
            3 => 10.0,
            4 => 1.0,
            _ => return None,
        };
        let shrunk = taken.map_or(1.0, |(long, _)| longer / long);
        let zoom = number(exif, Tag::DigitalZoomRatio).unwrap_or(1.0);
        Some(number(exif, Tag::FocalLength)? * resolution / unit * shrunk * zoom)
    });
    let focal =
        focal.ok_or("its EXIF does not give the focal length in pixels or in millimetres of 35 mm film")?;
    if POSSIBLE.contains(&(focal / longer)) {
        Ok(focal)
    } else {
        Err("the focal length in its EXIF is outside of the possible range")
    }
}

/// The first number of a field, when it is one above 0: 0 stands for "unknown".
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let field = exif.get_field(tag, In::PRIMARY)?;
    let value = match &field.value {
        Value::Rational(all) => all.first().map(|r| f64::from(r.num) / f64::from(r.denom)),
        _ => field.value.get_uint(0).map(f64::from),
    };
    value.filter(|v| v.is_finite() && *v > 0.0)
}
