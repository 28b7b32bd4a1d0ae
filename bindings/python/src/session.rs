//! Sessions: several images of one scene, sealed so that the lines of one keypoint do not intersect at it.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_client::{Orientation, SessionAnchors, SessionOptions};
use veiloc_obfuscation::device_rng;
use veiloc_pose::Stop;

use crate::arrays;
use crate::blocking::interruptible;
use crate::device::{SealArguments, SealInput};
use crate::errors::{BindingError, Result};
use crate::profile::Profile;

/// Seals a sequence of images of one scene.
///
/// The images share their anchors, and no keypoint is sent under two anchors.
///
/// A session holds keypoint positions: `bytes(session)` must not leave the device.
///
/// Args:
///     anchors: the frame in which the anchors are fixed: `"world"`, `"gravity"` or `"image"`.
///
/// Raises:
///     InputError: `anchors` is another string.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Session(Mutex<veiloc_client::Session>);

impl Session {
    fn locked(&self) -> std::sync::MutexGuard<'_, veiloc_client::Session> {
        // A poisoned lock is safe: a session changes only after sealing succeeded.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (*, anchors="world"))]
    fn new(anchors: &str) -> Result<Self> {
        let anchors: SessionAnchors = anchors.parse().map_err(BindingError::input)?;
        let options = SessionOptions::default().with_anchors(anchors);
        Ok(Self(Mutex::new(veiloc_client::Session::new(options, &mut device_rng()?))))
    }

    /// Decodes a session.
    ///
    /// Raises:
    ///     Error: the bytes are not a session.
    #[staticmethod]
    fn from_bytes(data: &[u8]) -> Result<Self> {
        Ok(Self(Mutex::new(veiloc_client::Session::from_bytes(data)?)))
    }

    /// Reads a session file, also one that `veiloc seal --session` wrote.
    ///
    /// Raises:
    ///     Error: the file cannot be read, or is not a session.
    #[staticmethod]
    fn open(path: PathBuf) -> Result<Self> {
        let bytes = std::fs::read(&path).map_err(|e| BindingError::file(&path, e))?;
        Self::from_bytes(&bytes)
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.locked().to_bytes())
    }

    /// Seals the next image. When this fails, the session does not change.
    ///
    /// Args:
    ///     orientation: quaternion `[w, x, y, z]`, rotation from a fixed world frame to the camera (gyroscope,
    ///         odometry).
    ///     down: `[x, y, z]`, measured down direction in the camera frame, for the session's anchors. It is sent, rounded,
    ///         with a standard deviation of 0.5 degrees, unless `gravity` is given.
    ///     send_gravity: False does not send it.
    ///     image, camera, profile, scheme, max_keypoints, max_image_side, angle_bits, gravity, focal, mask: as for `veiloc.seal`.
    ///
    /// Returns:
    ///     The bytes of the sealed query.
    ///
    /// Raises:
    ///     ImageError, QueryError, InputError: as for `veiloc.seal`.
    #[pyo3(signature = (image, camera, profile, *, orientation=None, down=None, send_gravity=true, scheme="dcl", max_keypoints=None, max_image_side=None, angle_bits=12, gravity=None, focal=None, mask=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn seal<'py>(
        &self,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
        camera: Option<&Bound<'py, PyAny>>,
        profile: &Profile,
        orientation: Option<&Bound<'py, PyAny>>,
        down: Option<&Bound<'py, PyAny>>,
        send_gravity: bool,
        scheme: &str,
        max_keypoints: Option<usize>,
        max_image_side: Option<u32>,
        angle_bits: u8,
        gravity: Option<&Bound<'py, PyAny>>,
        focal: Option<&str>,
        mask: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyBytes>> {
        let arguments = SealArguments { scheme, max_keypoints, max_image_side, angle_bits, gravity, focal };
        let mut input = SealInput::new(image, camera, mask, &arguments)?;
        if !send_gravity {
            input.options = input.options.without_gravity();
        }
        let orientation = orientation_of(orientation, down)?;
        let bytes = interruptible(py, &Stop::default(), || -> Result<Vec<u8>> {
            let (features, camera) = input.extracted(profile)?;
            let query = self.locked().seal(
                features,
                &camera,
                &profile.0,
                &input.options,
                &orientation,
                &mut device_rng()?,
            )?;
            Ok(query.encode())
        })??;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Number of images that were sealed.
    #[getter]
    fn frames(&self) -> u32 {
        self.locked().frames()
    }

    /// How many times the session chose new anchors.
    #[getter]
    fn starts(&self) -> u32 {
        self.locked().starts()
    }

    fn __repr__(&self) -> String {
        format!("<Session of {} images, {} sets of anchors>", self.frames(), self.starts())
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
