//! Reads JSON-lines files, plain or gzipped, with errors that name the line.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write as _};
use std::path::Path;

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use serde::de::DeserializeOwned;
use veiloc_map::text::without_mark;

use crate::error::DatasetError;

/// Maximum length of a line; longer lines are refused before they fill the memory.
const MAX_LINE_BYTES: u64 = 256 << 20;

/// Name of a file in tables: without folders.
pub fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Every line of the file as a `T`, with its number from 1; empty lines are skipped. Gzip is detected by its first
/// bytes.
///
/// # Errors
/// [`DatasetError`] naming file and line.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<Vec<(usize, T)>, DatasetError> {
    let io = |source| DatasetError::Io { path: path.to_owned(), source };
    let mut file = BufReader::new(File::open(path).map_err(io)?);
    let gzipped = file.fill_buf().map_err(io)?.starts_with(&[0x1f, 0x8b]);
    let mut reader: Box<dyn BufRead> =
        if gzipped { Box::new(BufReader::new(MultiGzDecoder::new(file))) } else { Box::new(file) };
    let mut values = Vec::new();
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = reader.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line).map_err(io)?;
        if read == 0 {
            break;
        }
        let fault = |reason: String| DatasetError::Line { path: path.to_owned(), line: number, reason };
        if line.len() as u64 == MAX_LINE_BYTES {
            return Err(fault("the line is longer than 256 MiB".to_owned()));
        }
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        let value = serde_json::from_slice(without_mark(&line)).map_err(|e| fault(e.to_string()))?;
        values.push((number, value));
    }
    if values.is_empty() {
        return Err(DatasetError::Empty {
            path: path.to_owned(),
            what: "is empty; one JSON object per line is expected",
        });
    }
    Ok(values)
}

/// The bytes of a JSON-lines file, gzipped if `gzip` is set.
///
/// # Errors
/// Never in practice: writing to memory does not fail.
pub fn encode(lines: &[String], gzip: bool) -> std::io::Result<Vec<u8>> {
    let mut text = lines.join("\n").into_bytes();
    text.push(b'\n');
    if !gzip {
        return Ok(text);
    }
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&text)?;
    encoder.finish()
}
