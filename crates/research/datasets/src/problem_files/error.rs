//! Why data could not be read, naming file and line.

use std::path::PathBuf;

/// Why a data set could not be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of a JSON-lines file is not what it should be.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A file or folder that should hold something is empty.
    #[error("{}: {what}", path.display())]
    Empty {
        /// Which one.
        path: PathBuf,
        /// What is missing, and the remedy.
        what: &'static str,
    },
    /// An image could not be read.
    #[error(transparent)]
    Image(#[from] veiloc_features::FeatureError),
}
