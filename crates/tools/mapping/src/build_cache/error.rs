//! Why nothing can be kept.

use std::path::{Path, PathBuf};

use veiloc_features::FeatureError;

/// Why nothing can be kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeepingError {
    /// The folder, or a file in it.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// What makes the features, or cannot.
    #[error(transparent)]
    Features(#[from] FeatureError),
}

pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> KeepingError {
    move |source| KeepingError::Io { path: path.to_owned(), source }
}
