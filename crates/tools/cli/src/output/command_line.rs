//! The words of the command line, for documents that tell how they were made.

use std::ffi::OsString;
use std::sync::OnceLock;

static WORDS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Keeps the words behind the program's name: those of the process are others where the program is called from another one.
/// The first call counts.
pub(crate) fn keep(words: &[OsString]) {
    // A second command line of one process has no document of its own to tell it.
    let _ = WORDS.set(words.to_vec());
}

/// The words behind the program's name: those that were kept, else those of the process.
pub(crate) fn words() -> Vec<OsString> {
    WORDS.get().cloned().unwrap_or_else(|| std::env::args_os().skip(1).collect())
}
