//! What is wrong with a data set: which file, and what to do.

use std::path::{Path, PathBuf};

/// Why a data set could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A part of the data set is not there.
    #[error("{}: {what} is missing; {remedy}", path.display())]
    Missing {
        /// Where it should be.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// Where users get it, and what else helps.
        remedy: String,
    },
    /// Images that the lists name are not there.
    #[error("{}: {missing} of {named} images are missing, the first is {first}; {remedy}", folder.display())]
    MissingImages {
        /// Their folder.
        folder: PathBuf,
        /// How many.
        missing: usize,
        /// Of how many.
        named: usize,
        /// The first that is missing, as its list has it.
        first: String,
        /// Where users get them, and what else helps.
        remedy: String,
    },
    /// A line of a list, a model or a JSON-lines file is not what it should be.
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
    /// There is nothing to do with what is there.
    #[error("{}: {reason}", path.display())]
    Unusable {
        /// Which file or folder.
        path: PathBuf,
        /// Why, and the remedy.
        reason: String,
    },
    /// An image is none.
    #[error("{}: {source}; get the image again", path.display())]
    Image {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        source: image::ImageError,
    },
    /// Features of an image could not be extracted.
    #[error(transparent)]
    Features(#[from] veiloc_features::FeatureError),
    /// A COLMAP model could not be read, or poses do not fit together.
    #[error(transparent)]
    Map(#[from] veiloc_map::MapError),
}

impl DatasetError {
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    pub(crate) fn line(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Line { path: path.to_owned(), line, reason: reason.into() }
    }
}
