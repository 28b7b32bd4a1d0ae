//! Text lists of data sets.

use std::path::Path;

use veiloc_map::text::text_of;

use crate::error::DatasetError;

/// Reads a text file of the data set; the error for a missing file says what it is and where to get it.
pub(crate) fn read_text(path: &Path, what: &'static str, remedy: &str) -> Result<String, DatasetError> {
    match std::fs::read(path) {
        Ok(bytes) => text_of(bytes).map_err(|_| DatasetError::Unusable {
            path: path.to_owned(),
            reason: "is not text; get the file again".to_owned(),
        }),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            Err(DatasetError::Missing { path: path.to_owned(), what, remedy: remedy.to_owned() })
        }
        Err(e) => Err(DatasetError::io(path)(e)),
    }
}
