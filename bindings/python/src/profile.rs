//! Profiles of maps: the device needs one to seal queries.

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{BindingError, Result};

/// Profile of a map: the feature type, the vocabulary and the limits with which a device seals queries.
///
/// It holds no map data, and it cannot weaken the protection. Get one from `Map.profile`, `Client.profile`, a file
/// (`Profile.open`) or bytes (`Profile.from_bytes`); `bytes(profile)` is the content of a profile file.
#[pyclass(frozen, module = "veiloc", from_py_object)]
#[derive(Clone)]
pub(crate) struct Profile(pub(crate) veiloc_protocol::Profile);

#[pymethods]
impl Profile {
    /// Reads a profile file that `veiloc map profile` wrote.
    ///
    /// Raises:
    ///     QueryError: the file cannot be read, or is not a profile.
    #[staticmethod]
    fn open(path: PathBuf) -> Result<Self> {
        let bytes = std::fs::read(&path).map_err(|e| BindingError::file(&path, e))?;
        veiloc_protocol::Profile::decode(&bytes).map(Self).map_err(|e| {
            BindingError::file(
                &path,
                format_args!("{e}; of a map file, Map.open(path).profile is the profile"),
            )
        })
    }

    /// Decodes a profile.
    ///
    /// Raises:
    ///     QueryError: the bytes are not a profile.
    #[staticmethod]
    fn from_bytes(data: &[u8]) -> Result<Self> {
        Ok(Self(veiloc_protocol::Profile::decode(data)?))
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.encode())
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((py.get_type::<Self>().getattr("from_bytes")?, (self.__bytes__(py),)))
    }

    /// Identifier of the profile. A map refuses queries that were sealed with another one.
    #[getter]
    fn id(&self) -> String {
        self.0.id().to_string()
    }

    /// Name of the local features.
    #[getter]
    fn features(&self) -> String {
        self.0.descriptor_kind().name().to_owned()
    }

    /// Name of the model that computes the global descriptor.
    #[getter]
    fn global_descriptor(&self) -> String {
        self.0.global_model().name().to_owned()
    }

    /// Most keypoints that the profile requests.
    #[getter]
    fn max_keypoints(&self) -> u32 {
        self.0.limits().max_keypoints
    }

    /// Longest image side that the profile requests, pixels.
    #[getter]
    fn max_image_side(&self) -> u32 {
        self.0.limits().max_image_side
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0.id() == other.0.id()
    }

    fn __hash__(&self) -> u64 {
        let [a, b, c, d, e, f, g, h, ..] = *self.0.id().as_bytes();
        u64::from_le_bytes([a, b, c, d, e, f, g, h])
    }

    fn __repr__(&self) -> String {
        format!("<Profile {}: {} features, {}>", self.0.id(), self.features(), self.global_descriptor())
    }
}
