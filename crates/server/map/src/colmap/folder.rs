//! Writes the folder of a model.

use std::fs;
use std::path::Path;

use crate::atomic_file::write_atomic;

use crate::error::MapError;

/// Writes the files of a model, each atomically.
pub(super) fn write_files<const N: usize>(dir: &Path, files: [(&str, Vec<u8>); N]) -> Result<(), MapError> {
    fs::create_dir_all(dir).map_err(MapError::io(dir))?;
    for (name, content) in files {
        let path = dir.join(name);
        write_atomic(&path, &content).map_err(MapError::io(&path))?;
    }
    Ok(())
}
