//! The arguments of the program, for documents that record their command line.

use std::ffi::OsString;
use std::sync::OnceLock;

static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Stores the arguments without the program's name: if another program calls this one, the arguments of the process
/// differ. The first call counts.
pub(crate) fn record(arguments: &[OsString]) {
    // A second call in the same process has no document of its own.
    let _ = ARGUMENTS.set(arguments.to_vec());
}

/// Returns the stored arguments, otherwise those of the process.
pub(crate) fn arguments() -> Vec<OsString> {
    ARGUMENTS.get().cloned().unwrap_or_else(|| std::env::args_os().skip(1).collect())
}

/// Returns the command line, quoted for a shell.
pub(crate) fn command_line() -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./,=:%+@".contains(c);
    let quoted = |word: String| {
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    };
    let words = arguments().into_iter();
    let words = words.map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("veiloc".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}
