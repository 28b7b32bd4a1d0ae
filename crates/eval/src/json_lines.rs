//! Reads JSON-lines files, plain or gzipped, and says which line is wrong.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;
use serde::de::DeserializeOwned;

use crate::error::EvalError;

/// No honest line is longer; a file that pretends to is refused before it fills the memory.
const LONGEST_LINE: u64 = 256 << 20;

/// What a table calls a file: its name without folders.
pub(crate) fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Every line of the file as a `T`; empty lines are passed over. Gzip is recognised by its first bytes.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<Vec<(usize, T)>, EvalError> {
    let io = |source| EvalError::Io { path: path.to_owned(), source };
    let mut file = BufReader::new(File::open(path).map_err(io)?);
    let gzipped = file.fill_buf().map_err(io)?.starts_with(&[0x1f, 0x8b]);
    let mut reader: Box<dyn BufRead> =
        if gzipped { Box::new(BufReader::new(MultiGzDecoder::new(file))) } else { Box::new(file) };
    let mut values = Vec::new();
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line).map_err(io)?;
        if read == 0 {
            break;
        }
        let fault = |reason: String| EvalError::Line { path: path.to_owned(), line: number, reason };
        if line.len() as u64 == LONGEST_LINE {
            return Err(fault("the line is longer than 256 MiB".to_owned()));
        }
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        let value = serde_json::from_slice(&line).map_err(|e| fault(e.to_string()))?;
        values.push((number, value));
    }
    if values.is_empty() {
        return Err(EvalError::Empty {
            path: path.to_owned(),
            what: "holds no line; one JSON object a line is expected",
        });
    }
    Ok(values)
}
