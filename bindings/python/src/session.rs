//! Several images of one place, sealed so that their lines do not cross in what they show.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_client::{Orientation, SessionAnchors, SessionOptions};
use veiloc_obfuscation::device_rng;
use veiloc_pose::Stop;

use crate::arrays;
use crate::device::{Ready, Wishes};
use crate::errors::{Fault, Result};
use crate::profile::Profile;
use crate::waiting::released;

/// The images of one place in a row: their anchors stay in the world, and what was told is not told again.
///
/// It holds where keypoints were: `bytes(session)` is for this device alone.
///
/// Args:
///     anchors: what they are tied to: `"world"`, `"gravity"` or `"image"`.
///
/// Raises:
///     InputError: another word.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Session(Mutex<veiloc_client::Session>);

impl Session {
    fn locked(&self) -> std::sync::MutexGuard<'_, veiloc_client::Session> {
        // A session changes as a whole, when sealing has succeeded.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (*, anchors="world"))]
    fn new(anchors: &str) -> Result<Self> {
        let anchors: SessionAnchors = anchors.parse().map_err(Fault::input)?;
        let options = SessionOptions::default().with_anchors(anchors);
        Ok(Self(Mutex::new(veiloc_client::Session::new(options, &mut device_rng()?))))
    }

    /// A session of its bytes.
    ///
    /// Raises:
    ///     Error: they are none.
    #[staticmethod]
    fn from_bytes(data: &[u8]) -> Result<Self> {
        Ok(Self(Mutex::new(veiloc_client::Session::from_bytes(data)?)))
    }

    /// Reads a session's file; the program's are the same.
    ///
    /// Raises:
    ///     Error: it cannot be read, or holds none.
    #[staticmethod]
    fn open(path: PathBuf) -> Result<Self> {
        let bytes = std::fs::read(&path).map_err(|e| Fault::file(&path, e))?;
        Self::from_bytes(&bytes)
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.locked().to_bytes())
    }

    /// Seals the next image. Nothing of the session changes when this fails.
    ///
    /// Args:
    ///     orientation: quaternion `[w, x, y, z]` from a frame that stays in the world to the camera (gyroscope, odometry).
    ///     down: `[x, y, z]`, as the device felt it in the camera's axes; kept here, and not sent.
    ///     image, camera, profile, scheme, max_keypoints, angle_bits, gravity, focal, mask: as of `veiloc.seal`.
    ///
    /// Returns:
    ///     The bytes of the sealed query.
    ///
    /// Raises:
    ///     ImageError, QueryError, InputError: as `veiloc.seal`.
    #[pyo3(signature = (image, camera, profile, *, orientation=None, down=None, scheme="dcl", max_keypoints=None, angle_bits=12, gravity=None, focal=None, mask=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn seal<'py>(
        &self,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
        camera: Option<&Bound<'py, PyAny>>,
        profile: &Profile,
        orientation: Option<&Bound<'py, PyAny>>,
        down: Option<&Bound<'py, PyAny>>,
        scheme: &str,
        max_keypoints: Option<usize>,
        angle_bits: u8,
        gravity: Option<&Bound<'py, PyAny>>,
        focal: Option<&str>,
        mask: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyBytes>> {
        let wishes = Wishes { scheme, max_keypoints, angle_bits, gravity, focal };
        let ready = Ready::new(image, camera, mask, &wishes)?;
        let held = held(orientation, down)?;
        let bytes = released(py, &Stop::default(), || -> Result<Vec<u8>> {
            let (features, camera) = ready.extracted(profile)?;
            let query = self.locked().seal(
                features,
                &camera,
                &profile.0,
                &ready.options,
                &held,
                &mut device_rng()?,
            )?;
            Ok(query.encode())
        })??;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Images that were sealed.
    #[getter]
    fn frames(&self) -> u32 {
        self.locked().frames()
    }

    /// How often the anchors were put somewhere new.
    #[getter]
    fn starts(&self) -> u32 {
        self.locked().starts()
    }

    fn __repr__(&self) -> String {
        format!("<Session of {} images, begun {} times>", self.frames(), self.starts())
    }
}

fn held(orientation: Option<&Bound<'_, PyAny>>, down: Option<&Bound<'_, PyAny>>) -> Result<Orientation> {
    let held = match orientation {
        None => Orientation::unknown(),
        Some(q) => Orientation::from_quaternion(arrays::vector::<4>("orientation", q)?).ok_or_else(|| {
            Fault::input("orientation: a quaternion [w, x, y, z] with a direction is needed")
        })?,
    };
    match down {
        None => Ok(held),
        Some(down) => held
            .with_down(arrays::vector::<3>("down", down)?)
            .ok_or_else(|| Fault::input("down: a vector with a direction is needed")),
    }
}
