//! What can go wrong, and whose fault it is.

/// Why the pose engine could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// A file of problems could not be read.
    #[error(transparent)]
    Dataset(#[from] veiloc_datasets::DatasetError),
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
}
