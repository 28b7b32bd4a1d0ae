//! The folder of a model, written.

use std::fs;
use std::path::Path;

use veiloc_replacing::{Readers, TargetLock, replace_file};

use crate::error::MapError;

/// Writes the files of a model, each of which is replaced whole.
pub(super) fn write_files<const N: usize>(dir: &Path, files: [(&str, Vec<u8>); N]) -> Result<(), MapError> {
    fs::create_dir_all(dir).map_err(MapError::io(dir))?;
    for (name, content) in files {
        let path = dir.join(name);
        let lock = TargetLock::acquire(&path).map_err(MapError::io(&path))?;
        replace_file(&lock, Readers::AsBefore, |out| out.write_all(&content)).map_err(MapError::io(&path))?;
    }
    Ok(())
}
