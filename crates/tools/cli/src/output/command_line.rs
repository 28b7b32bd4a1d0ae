//! The arguments of the program, for documents that record their command line.

use std::ffi::OsString;
use std::sync::OnceLock;

static WORDS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Stores the arguments without the program's name: if another program calls this one, the arguments of the process
/// differ. The first call counts.
pub(crate) fn keep(words: &[OsString]) {
    // A second call in the same process has no document of its own.
    let _ = WORDS.set(words.to_vec());
}

/// Returns the stored arguments, otherwise those of the process.
pub(crate) fn words() -> Vec<OsString> {
    WORDS.get().cloned().unwrap_or_else(|| std::env::args_os().skip(1).collect())
}
