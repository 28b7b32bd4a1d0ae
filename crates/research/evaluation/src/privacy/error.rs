//! Why a trade-off could not be judged, and whose fault it is.

use std::path::PathBuf;

/// Why a trade-off could not be judged.
#[derive(Debug, thiserror::Error)]
pub enum TradeoffError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
    /// Poses could not be evaluated.
    #[error(transparent)]
    Eval(#[from] crate::EvalError),
    /// Attacks could not run.
    #[error(transparent)]
    Audit(#[from] crate::audit::AuditError),
}
