//! Why a session's file cannot be used.

use std::io;
use std::path::PathBuf;

use veiloc_obfuscation::SessionBytesError;

/// Why a session file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionFileError {
    /// It cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another program has it open.
    #[error("{}: another program seals with this session; its frames must know of each other", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// It is no session, or damaged, or of another version.
    #[error("{}: {source}", path.display())]
    Bytes {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: SessionBytesError,
    },
    /// It was begun with other options.
    #[error("{}: the session was begun with other options (anchors, band or cells)", path.display())]
    Options {
        /// The file.
        path: PathBuf,
    },
}
