//! Global descriptor files: one vector per image.

use std::path::Path;

use crate::MappingError;
use crate::importers::hloc::archive::Archive;
use crate::importers::hloc::write::{GroupTree, NewDataset, Values};

const GLOBAL: &str = "global_descriptor";
/// Maximum number of elements per vector.
const MAX_DIM: usize = 1 << 16;

/// A global descriptor file.
#[derive(Debug)]
pub struct GlobalsFile(Archive);

impl GlobalsFile {
    /// Opens a file; each vector is read on demand.
    ///
    /// # Errors
    /// [`MappingError::Io`], [`MappingError::NotHdf5`].
    pub fn open(path: &Path) -> Result<Self, MappingError> {
        Archive::open(path).map(Self)
    }

    /// Returns the names of all images.
    ///
    /// # Errors
    /// [`MappingError::BadInFile`] for groups that cannot be read, or are nested without end.
    pub fn names(&self) -> Result<Vec<String>, MappingError> {
        self.0.names(GLOBAL)
    }

    /// Reads the vector of an image, `[dim]`.
    ///
    /// # Errors
    /// [`MappingError::MissingInFile`]; [`MappingError::BadInFile`] for a dataset that cannot be read, is not finite,
    /// or is not a vector.
    pub fn read(&self, name: &str) -> Result<Vec<f32>, MappingError> {
        let missing = || MappingError::MissingInFile {
            path: self.0.path().to_owned(),
            what: "global descriptor",
            name: name.to_owned(),
        };
        let group = self.0.group(name).ok_or_else(missing)?;
        let numbers = self.0.numbers(name, &group, GLOBAL)?.ok_or_else(missing)?;
        let bad = |reason: &str| Err(self.0.bad(&format!("{name}/{GLOBAL}"), reason));
        if numbers.shape.iter().filter(|side| **side != 1).count() > 1 || numbers.values.len() > MAX_DIM {
            return bad("is not a single vector; write the file again");
        }
        if numbers.values.iter().any(|value| !value.is_finite()) {
            return bad("has numbers that are not finite; extract the image again");
        }
        Ok(numbers.values)
    }
}

/// Writes the vectors of images by name, as float32.
///
/// # Errors
/// [`MappingError::Unwritable`] for a duplicate name; [`MappingError::Io`].
pub fn write_globals(
    path: &Path,
    images: impl IntoIterator<Item = (String, Vec<f32>)>,
) -> Result<(), MappingError> {
    let mut tree = GroupTree::default();
    for (name, vector) in images {
        let shape = vec![vector.len()];
        tree.put(
            &name,
            vec![NewDataset { name: GLOBAL, shape, values: Values::Single(vector), attribute: None }],
        )?;
    }
    tree.save(path)
}
