//! Lists of image pairs: two names per line.

use std::path::Path;

use veiloc_map::atomic_file::write_atomic;
use veiloc_map::text::without_mark;

use crate::MappingError;

/// Reads a list of pairs; empty lines are ignored.
///
/// # Errors
/// [`MappingError::Io`]; [`MappingError::PairsLine`] for a line that does not have two different names, or a file that
/// is not text or has no pair.
pub fn read_pairs(path: &Path) -> Result<Vec<(String, String)>, MappingError> {
    let bytes = std::fs::read(path).map_err(|source| MappingError::Io { path: path.to_owned(), source })?;
    let refused = |line, reason: &str| MappingError::PairsLine {
        path: path.to_owned(),
        line,
        reason: reason.to_owned(),
    };
    let text = std::str::from_utf8(without_mark(&bytes))
        .map_err(|_| refused(1, "is not text; give a list with two image names per line"))?;
    let mut pairs = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            [] => {}
            [first, second] if first != second => pairs.push((first.to_owned(), second.to_owned())),
            _ => return Err(refused(number, "does not have two different names separated by a space")),
        }
    }
    if pairs.is_empty() {
        return Err(refused(1, "has no pair; write two image names per line"));
    }
    Ok(pairs)
}

/// Checks that a list of pairs can hold a name.
///
/// # Errors
/// [`MappingError::Unwritable`] for a name with white space, which separates the names in such a list.
pub fn check_pair_name(name: &str) -> Result<(), MappingError> {
    if name.is_empty() || name.contains(char::is_whitespace) {
        let reason = "white space separates the names in a list of pairs".to_owned();
        return Err(MappingError::Unwritable { name: name.to_owned(), reason });
    }
    Ok(())
}

/// Writes a list of pairs.
///
/// # Errors
/// As [`check_pair_name`], and [`MappingError::Io`].
pub fn write_pairs<'a>(
    path: &Path,
    pairs: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<(), MappingError> {
    let mut text = String::new();
    for (first, second) in pairs {
        check_pair_name(first)?;
        check_pair_name(second)?;
        text.extend([first, " ", second, "\n"]);
    }
    write_atomic(path, text.as_bytes()).map_err(|source| MappingError::Io { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_round_trip_and_invalid_lines_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("pairs.txt");
        write_pairs(&path, [("db/a.jpg", "db/b.jpg"), ("db/a.jpg", "c.png")]).expect("written");
        assert_eq!(std::fs::read_to_string(&path).expect("text"), "db/a.jpg db/b.jpg\ndb/a.jpg c.png\n");
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(
            read_pairs(&path).expect("pairs"),
            [pair("db/a.jpg", "db/b.jpg"), pair("db/a.jpg", "c.png")]
        );
        assert!(write_pairs(&path, [("a b.jpg", "c.jpg")]).is_err());
        std::fs::write(&path, "\u{feff}a.jpg b.jpg\r\n").expect("written");
        assert_eq!(
            read_pairs(&path).expect("pairs"),
            [pair("a.jpg", "b.jpg")],
            "a byte order mark is no part of the name"
        );
        for text in ["", "\n", "a.jpg\n", "a b c\n", "a a\n"] {
            std::fs::write(&path, text).expect("written");
            assert!(matches!(read_pairs(&path), Err(MappingError::PairsLine { line: 1, .. })), "{text:?}");
        }
        std::fs::write(&path, [0xff, 0xfe]).expect("written");
        assert!(read_pairs(&path).is_err());
    }
}
