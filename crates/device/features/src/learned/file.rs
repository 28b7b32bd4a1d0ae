//! Reading a file with a size limit.

use std::path::Path;

use crate::FeatureError;

/// All bytes of a file of at most `most` bytes.
pub(crate) fn read(path: &Path, most: u64) -> Result<Vec<u8>, FeatureError> {
    check(path, most)?;
    std::fs::read(path).map_err(|source| FeatureError::Read { path: path.to_owned(), source })
}

fn check(path: &Path, most: u64) -> Result<(), FeatureError> {
    let failed = |source| FeatureError::Read { path: path.to_owned(), source };
    let size = std::fs::metadata(path).map_err(failed)?.len();
    if size > most {
        let reason = format!("it has {size} bytes, more than the maximum ({most})");
        return Err(FeatureError::Network { path: path.to_owned(), reason });
    }
    Ok(())
}
