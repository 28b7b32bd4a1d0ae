//! Why nothing was detected.

use std::path::PathBuf;

use crate::FeatureError;

/// Why a detector cannot be used. Whoever meant to hide something sends nothing then.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DetectorError {
    /// The file could not be read.
    #[error("cannot read the detector {}: {source}; check the path and the permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is no model, is damaged, or needs what is not here.
    #[error("{}: this is no detector that can be used: {reason}; give an ONNX file of YOLO's form", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The detector broke on an image.
    #[error("the detector could not run: {reason}")]
    Run {
        /// What it said.
        reason: String,
    },
    /// A class that the detector does not know.
    #[error("the detector knows no class {asked}; it knows: {known}")]
    UnknownClass {
        /// What was asked for.
        asked: String,
        /// The names of those it knows.
        known: String,
    },
    /// No class was named.
    #[error("no class to hide; the detector knows: {known}")]
    NoClass {
        /// The names of those it knows.
        known: String,
    },
    /// The image cannot be read, or what was found covers all of it.
    #[error(transparent)]
    Image(#[from] FeatureError),
}
