//! What can be wrong with descriptors.

/// Why descriptors were refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// The bytes are not a whole number of descriptors.
    #[error("{bytes} bytes are not a whole number of descriptors of {dim} bytes")]
    Length {
        /// How many bytes there were.
        bytes: usize,
        /// Bytes of one descriptor.
        dim: usize,
    },
}
