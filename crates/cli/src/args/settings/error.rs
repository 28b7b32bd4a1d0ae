//! Errors of settings, with their location and the remedy.

use std::path::PathBuf;

/// Why settings cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("{}: {source}; give a settings file with --config or VEILOC_CONFIG", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not valid TOML.
    #[error("{}, line {line}: {reason}; a line is `key = value` (TOML)", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The message of the TOML parser.
        reason: String,
    },
    /// The key does not exist.
    #[error("{}, line {line}: {key:?} is not a setting; {remedy}", path.display())]
    UnknownKey {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The key.
        key: String,
        /// The key that the user probably meant.
        remedy: String,
    },
    /// The value has the wrong type.
    #[error("{}, line {line}: {key} has {found}, and needs {expected}", path.display())]
    WrongType {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The key.
        key: String,
        /// The type of the value.
        found: &'static str,
        /// The expected type, with an example.
        expected: String,
    },
    /// The flag refuses the value.
    #[error("{location}: {key} has an invalid value: {reason}")]
    Value {
        /// File and line, or the variable.
        location: String,
        /// The key.
        key: String,
        /// The message of the flag's parser.
        reason: String,
    },
    /// A path is not UTF-8, and TOML cannot hold it.
    #[error("{key}: a path that is not UTF-8 cannot be printed as TOML; rename it")]
    NotText {
        /// The key.
        key: String,
    },
}
