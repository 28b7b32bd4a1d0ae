//! Errors of the demo.

use std::path::PathBuf;

/// Why the demo could not run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DemoError {
    /// A file could not be written or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The scene could not be rendered or written.
    #[error("{0}")]
    Scene(String),
    /// Features of a view could not be extracted.
    #[error(transparent)]
    Extract(#[from] veiloc_obfuscation::SealError),
    /// A view could not be sealed.
    #[error("{name}: {source}")]
    Seal {
        /// The view.
        name: String,
        /// The cause.
        source: veiloc_obfuscation::SealError,
    },
    /// The hidden views could not be localized, or the attacks failed.
    #[error(transparent)]
    Eval(#[from] veiloc_evaluation::EvalError),
    /// The scene could not be mapped.
    #[error(transparent)]
    Mapping(#[from] veiloc_mapping::MappingError),
    /// The map could not be opened.
    #[error(transparent)]
    Map(#[from] veiloc_map::MapError),
}
