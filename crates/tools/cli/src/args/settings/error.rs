//! Why settings cannot be used, with where they stand and what to do.

use std::path::PathBuf;

/// Why settings cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("{}: {source}; give a file of settings with --config or VEILOC_CONFIG", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no TOML.
    #[error("{}, line {line}: {reason}; a line is `key = value` (TOML)", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What the reader of TOML said.
        reason: String,
    },
    /// A key that is none.
    #[error("{}, line {line}: {key:?} is no setting; {remedy}", path.display())]
    UnknownKey {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The key.
        key: String,
        /// What may have been meant.
        remedy: String,
    },
    /// A value of another type.
    #[error("{}, line {line}: {key} is given {found}, and needs {expected}", path.display())]
    WrongType {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The key.
        key: String,
        /// What it is given.
        found: &'static str,
        /// What it needs, with an example.
        expected: String,
    },
    /// A value that the flag would refuse.
    #[error("{place}: {key} cannot be that: {reason}")]
    Value {
        /// File and line, or the variable.
        place: String,
        /// The key.
        key: String,
        /// What the flag says.
        reason: String,
    },
    /// A path that TOML cannot hold.
    #[error("{key}: a path that is no UTF-8 cannot be printed as TOML; rename it")]
    NotText {
        /// The key.
        key: String,
    },
}
