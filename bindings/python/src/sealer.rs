//! Sealers: from an image to its features, and from those to the bytes of a query.

use std::ffi::CString;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_features::DisplayTurn;
use veiloc_obfuscation::{DeviceLimits, KnownCamera, Orientation, PackUse, SealOptions, device_rng};
use veiloc_pose::Stop;
use veiloc_protocol::{AngleBits, CoarseGravity, FocalKnowledge, Scheme};

use crate::arrays;
use crate::blocking::interruptible;
use crate::camera::camera_of;
use crate::errors::{BindingError, Result};
use crate::images::{ImageInput, mask_of};
use crate::pack::Pack;
use crate::profile::Profile;
use crate::sealed_in::bytes_of;
use crate::session::Session;

/// Seals images for one map: `extract`, then `seal`. Only the bytes of sealed queries leave the device.
///
/// The device decides all options; a profile cannot change them.
///
/// Args:
///     profile: profile of the map.
///     scheme: `"dcl"` and its layouts, `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides
///         nothing.
///     max_keypoints: most keypoints to send; a query has at least 256 rows, filled up with decoys. Default: the number
///         that the profile requests, at most 2048.
///     max_image_side: longest side to which images are scaled down, pixels, whatever the profile requests; default
///         2048. The next smaller size of the device's list is used.
///     angle_bits: bits of each quantized angle.
///     send_gravity: False sends no gravity direction.
///     pack: pack of the map: nothing is sent that the place does not know. Default: all descriptors are sent.
///     send: what is sent with a pack: `"matches"`, the points that keypoints match in the pack, and no descriptor
///         (default), or `"explained"`, the descriptors that the pack explains.
///
/// Raises:
///     QueryError: the profile requests more than this device sends, the scheme is unknown, or the pack is of another map
///         or too large.
///     InputError: `send` is unknown, or given without a pack.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Sealer(Arc<veiloc_obfuscation::Sealer>);

/// A `Sealer` for the images of one session.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct SessionSealer {
    sealer: Arc<veiloc_obfuscation::Sealer>,
    session: Py<Session>,
}

/// The features of an image with their camera, until they are sealed. `len(extracted)` is the number of keypoints.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Extracted {
    /// `None` once they were sealed.
    features: Mutex<Option<veiloc_obfuscation::Extracted>>,
    keypoints: usize,
}

#[pymethods]
impl Sealer {
    #[new]
    #[pyo3(signature = (profile, *, scheme="dcl", max_keypoints=None, max_image_side=None, angle_bits=12, send_gravity=true, pack=None, send=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn new(
        py: Python<'_>,
        profile: &Profile,
        scheme: &str,
        max_keypoints: Option<usize>,
        max_image_side: Option<u32>,
        angle_bits: u8,
        send_gravity: bool,
        pack: Option<&Pack>,
        send: Option<&str>,
    ) -> Result<Self> {
        let scheme: Scheme = scheme.parse()?;
        let mut options = match scheme {
            Scheme::Points => SealOptions::unprotected_points(),
            hidden => SealOptions::new(hidden)?,
        };
        options = options.with_angle_bits(AngleBits::new(angle_bits)?);
        if let Some(most) = max_keypoints {
            options = options.with_max_keypoints(most);
        }
        if let Some(most) = max_image_side {
            options = options.with_limits(DeviceLimits { max_image_side: most, ..DeviceLimits::default() });
        }
        if !send_gravity {
            options = options.without_gravity();
        }
        let send = send.map(str::parse::<PackUse>).transpose();
        let send = send.map_err(|e| BindingError::input(format_args!("send: {e}")))?;
        options = match (pack, send) {
            (Some(pack), send) => options.with_place(py.detach(|| pack.place())?, send.unwrap_or_default()),
            (None, Some(_)) => {
                return Err(BindingError::input("send: it says what is sent with a pack; give pack="));
            }
            (None, None) => options,
        };
        Ok(Self(Arc::new(veiloc_obfuscation::Sealer::new(&profile.0, options)?)))
    }

    /// Extracts the features of an image, as the profile requests them.
    ///
    /// Args:
    ///     image: a path, or an array as for `veiloc.extract`.
    ///     camera: a dictionary or text as for `estimate_absolute_pose`; None reads the focal length from the file's EXIF,
    ///         `"unknown"` sends a guess, which localization corrects.
    ///     mask: a path (black hides) or an array `[H, W]` of bool (True hides); hidden pixels are not used.
    ///     focal: `"calibrated"`, `"exif"` or `"unknown"`. Default: follows from `camera`.
    ///     gravity: `[x, y, z]` or `[x, y, z, degrees]`: measured down direction in the camera frame, and its standard
    ///         deviation (2). It is sent with the query.
    ///     orientation: quaternion `[w, x, y, z]`, rotation from a fixed world frame to the camera (gyroscope,
    ///         odometry), for a session.
    ///     down: `[x, y, z]`, measured down direction in the camera frame, for the session's anchors. It is sent, rounded,
    ///         with a standard deviation of 0.5 degrees, unless `gravity` is given.
    ///
    /// Raises:
    ///     ImageError: the image or the mask cannot be used.
    ///     InputError: another argument is invalid.
    #[pyo3(signature = (image, camera, *, mask=None, focal=None, gravity=None, orientation=None, down=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn extract(
        &self,
        py: Python<'_>,
        image: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
        focal: Option<&str>,
        gravity: Option<&Bound<'_, PyAny>>,
        orientation: Option<&Bound<'_, PyAny>>,
        down: Option<&Bound<'_, PyAny>>,
    ) -> Result<Extracted> {
        let image = ImageInput::from_python(image)?;
        let mut known = known_camera(py, &image, camera)?;
        if let Some(name) = focal {
            known.focal = name.parse::<FocalKnowledge>().map_err(BindingError::input)?;
        }
        let (mask, gravity) = (mask.map(mask_of).transpose()?, gravity.map(coarse_gravity).transpose()?);
        let orientation = orientation_of(orientation, down)?;
        let stop = Stop::default();
        let extracted = interruptible(py, &stop, || -> Result<_> {
            Ok(self.0.extract(image.load(mask.as_ref())?.with_stop(&stop), known)?)
        })??;
        let keypoints = extracted.features().keypoints.len();
        let extracted = extracted.with_orientation(orientation).with_gravity(gravity);
        Ok(Extracted { features: Mutex::new(Some(extracted)), keypoints })
    }

    /// Seals the features of an image on its own, once. For several images of the same scene use `in_session`.
    ///
    /// Randomness comes from the operating system. When the network fails, send the same bytes again.
    ///
    /// Returns:
    ///     The bytes of the sealed query.
    ///
    /// Raises:
    ///     Error: the image shows too little texture.
    ///     NotThisPlaceError: hardly anything in the image is of the place of the pack.
    ///     InputError: the features were sealed already.
    fn seal<'py>(&self, py: Python<'py>, extracted: &Extracted) -> Result<Bound<'py, PyBytes>> {
        let features = extracted.take()?;
        let query = interruptible(py, &Stop::default(), || -> Result<_> {
            Ok(self.0.seal(features, &mut device_rng()?)?)
        })??;
        Ok(bytes_of(py, &query))
    }

    /// For the next images of a session, which share their anchors.
    fn in_session(&self, session: Py<Session>) -> SessionSealer {
        SessionSealer { sealer: Arc::clone(&self.0), session }
    }

    fn __repr__(&self) -> String {
        format!("<Sealer for the profile {}: {}>", self.0.profile().id(), self.0.options().scheme())
    }
}

#[pymethods]
impl SessionSealer {
    /// Seals the features of the next image, as `Sealer.seal`. When this fails, the session does not change.
    ///
    /// Returns:
    ///     The bytes of the sealed query.
    ///
    /// Raises:
    ///     Error, InputError: as for `Sealer.seal`; the session cannot go on with this image.
    fn seal<'py>(&self, py: Python<'py>, extracted: &Extracted) -> Result<Bound<'py, PyBytes>> {
        let features = extracted.take()?;
        let query = interruptible(py, &Stop::default(), || -> Result<_> {
            let mut session = self.session.get().locked();
            Ok(self.sealer.in_session(&mut session).seal(features, &mut device_rng()?)?)
        })??;
        Ok(bytes_of(py, &query))
    }
}

#[pymethods]
impl Extracted {
    fn __len__(&self) -> usize {
        self.keypoints
    }

    fn __repr__(&self) -> String {
        format!("<Extracted: {} keypoints>", self.keypoints)
    }
}

impl Extracted {
    /// The features, which are used up then: an image is sealed once (rule L7).
    fn take(&self) -> Result<veiloc_obfuscation::Extracted> {
        let taken = self.features.lock().unwrap_or_else(PoisonError::into_inner).take();
        taken
            .ok_or_else(|| BindingError::input("extracted: it was sealed already; send the same bytes again"))
    }
}

fn known_camera(
    py: Python<'_>,
    image: &ImageInput,
    camera: Option<&Bound<'_, PyAny>>,
) -> Result<KnownCamera> {
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
    Ok(known)
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

fn orientation_of(
    orientation: Option<&Bound<'_, PyAny>>,
    down: Option<&Bound<'_, PyAny>>,
) -> Result<Orientation> {
    let orientation = match orientation {
        None => Orientation::unknown(),
        Some(q) => Orientation::from_quaternion(arrays::vector::<4>("orientation", q)?).ok_or_else(|| {
            BindingError::input("orientation: must be a quaternion [w, x, y, z] that is not zero")
        })?,
    };
    match down {
        None => Ok(orientation),
        Some(down) => orientation
            .with_down(arrays::vector::<3>("down", down)?)
            .ok_or_else(|| BindingError::input("down: must be a vector that is not zero")),
    }
}
