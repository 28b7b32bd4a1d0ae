//! Text files that people and other programs write: UTF-8, perhaps after the byte order mark of Windows editors, or UTF-16 after
//! its mark, as PowerShell's `>` writes it.

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
/// The bytes are not UTF-8, and have no mark of UTF-16.
pub fn text_of(mut bytes: Vec<u8>) -> Result<String, FromUtf8Error> {
    for (mark, unit) in
        [([0xff, 0xfe], u16::from_le_bytes as fn([u8; 2]) -> u16), ([0xfe, 0xff], u16::from_be_bytes)]
    {
        if let Some(rest) = bytes.strip_prefix(&mark) {
            let units: Vec<u16> = rest.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
            return Ok(String::from_utf16_lossy(&units));
        }
    }
    let mark = bytes.len() - without_mark(&bytes).len();
    bytes.drain(..mark);
    String::from_utf8(bytes)
}

/// Reads a text file, without the byte order mark that may begin it.
///
/// # Errors
/// The error of the system; [`ErrorKind::InvalidData`] if the file is neither UTF-8 nor marked UTF-16.
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
        assert!(text_of(vec![b'a', 0xff]).is_err());
    }

    #[test]
    fn utf_16_is_read_by_its_mark() {
        let units: Vec<u16> = "\u{feff}Küche\r\n".encode_utf16().collect();
        for bytes in [u16::to_le_bytes as fn(u16) -> [u8; 2], u16::to_be_bytes] {
            let mut file: Vec<u8> = units.iter().flat_map(|unit| bytes(*unit)).collect();
            assert_eq!(text_of(file.clone()).expect("text"), "Küche\r\n");
            // Cut in a character.
            file.pop();
            assert_eq!(text_of(file).expect("text"), "Küche\r");
        }
    }
}
