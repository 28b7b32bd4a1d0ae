//! Errors of data sets: the file and the remedy.

use std::path::{Path, PathBuf};

/// Why a data set could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
    /// A part of the data set is missing.
    #[error("{}: {what} is missing; {remedy}", path.display())]
    Missing {
        /// Its expected path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// Where to get it, and other remedies.
        remedy: String,
    },
    /// Images named by the lists are missing.
    #[error("{}: {missing} of {named} images are missing, the first is {first}; {remedy}", folder.display())]
    MissingImages {
        /// Their folder.
        folder: PathBuf,
        /// Number of missing images.
        missing: usize,
        /// Number of images in the lists.
        named: usize,
        /// The first missing image, as in its list.
        first: String,
        /// Where to get them, and other remedies.
        remedy: String,
    },
    /// A line of a list, a model or a JSON-lines file is invalid.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A file or folder is empty.
    #[error("{}: {what}", path.display())]
    Empty {
        /// The file or folder.
        path: PathBuf,
        /// What is missing, and the remedy.
        what: &'static str,
    },
    /// The data cannot be used.
    #[error("{}: {reason}", path.display())]
    Unusable {
        /// The file or folder.
        path: PathBuf,
        /// Why, and the remedy.
        reason: String,
    },
    /// A file is not a valid image.
    #[error("{}: {source}; get the image again", path.display())]
    Image {
        /// The file.
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
    /// A model of another program could not be read.
    #[error(transparent)]
    Mapping(#[from] veiloc_mapping::MappingError),
}

impl DatasetError {
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}
