//! Files of tensors: PyTorch's `.pth`, NumPy's `.npz` and MATLAB's `.mat`.
//!
//! Such files come from anywhere, and PyTorch's hold a program that Python would run. Here nothing is run: a small reader
//! takes the few instructions that describe tensors, and refuses every other file ([`WeightsError`]).

mod bytes;
mod mat;
mod npz;
mod pickle;
mod pth;
mod zip;

use std::collections::BTreeMap;
use std::path::Path;

use crate::FeatureError;
use crate::learned::{Tensor, WeightsError};

/// Most bytes of a file that is read.
const MOST_BYTES: u64 = 1 << 30;

/// The tensors of a file by name. Those of whole numbers are left out: counters of a training.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Weights(BTreeMap<String, Tensor>);

impl Weights {
    /// Reads a file.
    ///
    /// # Errors
    /// [`FeatureError::Read`], and [`FeatureError::Weights`] for a file that is damaged or holds anything but tensors.
    pub fn open(path: &Path) -> Result<Self, FeatureError> {
        let weights = |source| FeatureError::Weights { path: path.to_owned(), source: Box::new(source) };
        if let Some(stream) = crate::learned::file::stream_if(path, mat::MARK, MOST_BYTES)? {
            return mat::of_stream(stream).and_then(Self::of_all).map_err(weights);
        }
        let bytes = crate::learned::file::read(path, MOST_BYTES)?;
        Self::of_bytes(&bytes).map_err(weights)
    }

    /// The same of what is in memory.
    ///
    /// # Errors
    /// [`WeightsError`].
    pub fn of_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let all = if zip::is_zip(bytes) {
            let archive = zip::Archive::read(bytes)?;
            if archive.names().any(|name| name.ends_with("data.pkl")) {
                pth::of_archive(&archive)?
            } else {
                npz::of_archive(&archive)?
            }
        } else if bytes.starts_with(mat::MARK) {
            mat::of_stream(bytes)?
        } else {
            pth::of_stream(bytes)?
        };
        Self::of_all(all)
    }

    fn of_all(all: Vec<(String, Tensor)>) -> Result<Self, WeightsError> {
        let mut named = BTreeMap::new();
        for (name, tensor) in all {
            if named.insert(name.clone(), tensor).is_some() {
                return Err(WeightsError::NotTensors(format!("two tensors of the name {name:?}")));
            }
        }
        Ok(Self(named))
    }

    /// One of them, of this shape.
    ///
    /// # Errors
    /// [`WeightsError::Missing`], [`WeightsError::Shape`] and [`WeightsError::NotFinite`].
    pub fn get(&self, name: &str, shape: &[usize]) -> Result<&Tensor, WeightsError> {
        let tensor = self.0.get(name).ok_or_else(|| WeightsError::Missing(name.to_owned()))?;
        if tensor.shape != shape {
            let (expected, actual) = (shape.to_vec(), tensor.shape.clone());
            return Err(WeightsError::Shape { name: name.to_owned(), expected, actual });
        }
        if tensor.data.iter().any(|number| !number.is_finite()) {
            return Err(WeightsError::NotFinite(name.to_owned()));
        }
        Ok(tensor)
    }

    /// Takes one of them out, for large ones; sides of one pixel are left out of its shape.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] and [`WeightsError::NotFinite`].
    pub(crate) fn take(&mut self, name: &str) -> Result<Tensor, WeightsError> {
        let mut tensor = self.0.remove(name).ok_or_else(|| WeightsError::Missing(name.to_owned()))?;
        if tensor.data.iter().any(|number| !number.is_finite()) {
            return Err(WeightsError::NotFinite(name.to_owned()));
        }
        tensor.shape.retain(|side| *side != 1);
        Ok(tensor)
    }

    /// The sides of a tensor, without those of one.
    ///
    /// # Errors
    /// [`WeightsError::Missing`].
    pub(crate) fn shape(&self, name: &str) -> Result<Vec<usize>, WeightsError> {
        let tensor = self.0.get(name).ok_or_else(|| WeightsError::Missing(name.to_owned()))?;
        Ok(tensor.shape.iter().copied().filter(|side| *side != 1).collect())
    }

    /// The first side of a tensor: how many channels a layer gives, where that differs between files.
    ///
    /// # Errors
    /// [`WeightsError::Missing`], also for a tensor without sides.
    pub fn channels(&self, name: &str) -> Result<usize, WeightsError> {
        let first = self.0.get(name).and_then(|tensor| tensor.shape.first());
        first.copied().ok_or_else(|| WeightsError::Missing(name.to_owned()))
    }

    /// These and one more; it takes the place of one with the same name.
    #[must_use]
    pub fn with(mut self, name: &str, tensor: Tensor) -> Self {
        self.0.insert(name.to_owned(), tensor);
        self
    }

    /// Their names, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}
