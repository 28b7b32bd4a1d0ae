//! Text files that people and other programs write: UTF-8, perhaps after the byte order mark of Windows editors.

use std::io::{Error, ErrorKind};
use std::path::Path;
use std::string::FromUtf8Error;

/// U+FEFF in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// The bytes of a text file without the byte order mark that may begin it.
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes)
}

/// The text of a file's bytes, without the byte order mark that may begin it.
///
/// # Errors
/// The bytes are not UTF-8.
pub fn text_of(mut bytes: Vec<u8>) -> Result<String, FromUtf8Error> {
    let mark = bytes.len() - without_mark(&bytes).len();
    bytes.drain(..mark);
    String::from_utf8(bytes)
}

/// Reads a text file, without the byte order mark that may begin it.
///
/// # Errors
/// The error of the system; [`ErrorKind::InvalidData`] if the file is not UTF-8.
pub fn read_text(path: &Path) -> std::io::Result<String> {
    text_of(std::fs::read(path)?).map_err(|error| Error::new(ErrorKind::InvalidData, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn byte_order_mark_is_skipped_at_the_start_only() {
        assert_eq!(text_of("\u{feff}a\u{feff}\n".into()).expect("text"), "a\u{feff}\n");
        assert_eq!(text_of("a".into()).expect("text"), "a");
        assert!(text_of(vec![0xff, 0xfe]).is_err());
    }
}
