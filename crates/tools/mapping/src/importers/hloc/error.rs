//! What can be wrong with a file of hloc's. Every message names the file and says what to do.

use std::path::PathBuf;

/// Why a file was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HlocError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no HDF5 file, or is cut short or damaged.
    #[error("{}: not a whole HDF5 file: {reason}; copy it again, or write it again with hloc", path.display())]
    NotHdf5 {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        reason: String,
    },
    /// The file holds nothing under this name.
    #[error("{}: holds no {what} of {name}; give the file that was made of this image", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// Name of the image, or of the pair.
        name: String,
    },
    /// What the file holds under a name is not what it should be.
    #[error("{}: {name}: {reason}", path.display())]
    Bad {
        /// The file.
        path: PathBuf,
        /// Name of the image or pair, with the name of its numbers.
        name: String,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// A line of a list of pairs is none.
    #[error("{}: line {line}: {reason}", path.display())]
    Pairs {
        /// The list.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// Something that is to be written cannot be.
    #[error("{name:?} cannot be written into a file of hloc's: {reason}")]
    Unwritable {
        /// Name of the image or pair.
        name: String,
        /// Why.
        reason: String,
    },
}
