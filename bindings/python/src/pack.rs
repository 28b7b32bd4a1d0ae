//! Packs of maps: with one a device sends only what the place knows, or matches by itself.

use std::path::PathBuf;
use std::sync::OnceLock;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use veiloc_obfuscation::KnownPlace;

use crate::errors::{BindingError, Result};
use crate::profile::Profile;

/// Pack of a map: the descriptors of its points, image by image, without positions.
///
/// A device that has it seals what the place knows and nothing else (`Sealer`). It shows what the place looks like, without
/// where, so the operator decides who gets it. Get one from `Map.pack`, `Client.pack`, a file (`Pack.open`) or bytes
/// (`Pack.from_bytes`); `bytes(pack)` is the content of a pack file.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Pack {
    pack: veiloc_protocol::Pack,
    /// Prepared by the first sealer.
    place: OnceLock<KnownPlace>,
}

impl Pack {
    /// The pack as sealers use it; they share it.
    pub(crate) fn place(&self) -> Result<KnownPlace> {
        if let Some(known) = self.place.get() {
            return Ok(known.clone());
        }
        let place = KnownPlace::new(self.pack.clone())?;
        Ok(self.place.get_or_init(|| place).clone())
    }
}

impl From<veiloc_protocol::Pack> for Pack {
    fn from(pack: veiloc_protocol::Pack) -> Self {
        Self { pack, place: OnceLock::new() }
    }
}

#[pymethods]
impl Pack {
    /// Reads a pack file that `veiloc map pack` wrote.
    ///
    /// Raises:
    ///     QueryError: the file cannot be read, or is not a pack.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> Result<Self> {
        py.detach(|| {
            let bytes = std::fs::read(&path).map_err(|e| BindingError::file(&path, e))?;
            let pack = veiloc_protocol::Pack::decode(&bytes).map_err(|e| BindingError::file(&path, e))?;
            Ok(pack.into())
        })
    }

    /// Decodes a pack.
    ///
    /// Raises:
    ///     QueryError: the bytes are not a pack.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> Result<Self> {
        Ok(py.detach(|| veiloc_protocol::Pack::decode(data))?.into())
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &py.detach(|| self.pack.encode()))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((py.get_type::<Self>().getattr("from_bytes")?, (self.__bytes__(py),)))
    }

    /// Identifier of the pack. A map refuses matches in another one.
    #[getter]
    fn id(&self) -> String {
        self.pack.id().to_string()
    }

    /// The profile of the map, for `Sealer`.
    #[getter]
    fn profile(&self) -> Profile {
        Profile(self.pack.profile().clone())
    }

    /// Number of points.
    #[getter]
    fn points(&self) -> u32 {
        self.pack.point_count()
    }

    /// Number of images.
    #[getter]
    fn images(&self) -> usize {
        self.pack.image_count()
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.pack.id() == other.pack.id()
    }

    fn __hash__(&self) -> u64 {
        let [a, b, c, d, e, f, g, h, ..] = *self.pack.id().as_bytes();
        u64::from_le_bytes([a, b, c, d, e, f, g, h])
    }

    fn __repr__(&self) -> String {
        format!("<Pack {}: {} points, {} images>", self.pack.id(), self.points(), self.images())
    }
}
