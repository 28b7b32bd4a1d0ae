//! Reading a file that must not be too large.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use crate::FeatureError;

/// All bytes of a file of at most `most`.
pub(crate) fn read(path: &Path, most: u64) -> Result<Vec<u8>, FeatureError> {
    check(path, most)?;
    std::fs::read(path).map_err(|source| FeatureError::Read { path: path.to_owned(), source })
}

/// A file of at most `most` bytes from its beginning, where it begins so; `None` where it does not.
pub(crate) fn stream_if(path: &Path, mark: &[u8], most: u64) -> Result<Option<impl Read>, FeatureError> {
    check(path, most)?;
    let failed = |source| FeatureError::Read { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(failed)?;
    let mut first = Vec::new();
    file.by_ref().take(mark.len() as u64).read_to_end(&mut first).map_err(failed)?;
    file.rewind().map_err(failed)?;
    Ok((first == mark).then(|| BufReader::new(file)))
}

fn check(path: &Path, most: u64) -> Result<(), FeatureError> {
    let failed = |source| FeatureError::Read { path: path.to_owned(), source };
    let size = std::fs::metadata(path).map_err(failed)?.len();
    if size > most {
        let reason = format!("it has {size} bytes, more than any such file ({most})");
        return Err(FeatureError::Network { path: path.to_owned(), reason });
    }
    Ok(())
}
