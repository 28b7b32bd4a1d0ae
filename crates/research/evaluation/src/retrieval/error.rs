//! What can go wrong, and whose fault it is.

/// Why retrieval could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum RetrievalError {
    /// What was asked for makes no sense together.
    #[error("{0}")]
    Options(String),
    /// An image could not be read, or its features not be extracted.
    #[error(transparent)]
    Extract(#[from] veiloc_features::FeatureError),
}
