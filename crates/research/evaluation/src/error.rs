//! What can go wrong in an evaluation, and whose fault it is.

use std::path::PathBuf;

/// Why an evaluation could not run.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of problems or keypoints could not be read.
    #[error(transparent)]
    Dataset(#[from] veiloc_datasets::DatasetError),
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
    /// A data set is not whole.
    #[error("{0}")]
    DataSet(String),
    /// Features of a query could not be extracted.
    #[error(transparent)]
    Extract(#[from] veiloc_obfuscation::ExtractError),
    /// The map could not be built or tested.
    #[error(transparent)]
    Mapping(#[from] veiloc_mapping::MappingError),
    /// A map or model file could not be read or written.
    #[error(transparent)]
    Map(#[from] veiloc_map::MapError),
    /// A map could not be cut into regions.
    #[error(transparent)]
    Regions(#[from] veiloc_map::regions::RegionsError),
}
