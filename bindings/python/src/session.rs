//! Sessions: several images of one scene, sealed so that the lines of one keypoint do not intersect at it.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_client::{SessionAnchors, SessionOptions};
use veiloc_obfuscation::device_rng;

use crate::errors::{BindingError, Result};

/// A sequence of images of one scene, sealed by `Sealer.in_session`.
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
    pub(crate) fn locked(&self) -> std::sync::MutexGuard<'_, veiloc_client::Session> {
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
