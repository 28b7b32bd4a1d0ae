//! Why two images cannot be compared.

/// Why two images cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JudgeError {
    /// Images of two sizes.
    #[error("images of {}x{} and {}x{} pixels cannot be compared; make them equally large", sizes[0][0], sizes[0][1], sizes[1][0], sizes[1][1])]
    Sizes {
        /// Width and height of each.
        sizes: [[u32; 2]; 2],
    },
    /// An image with a side shorter than the window.
    #[error("an image of {}x{} pixels is too small: each side must have {least}", size[0], size[1])]
    Small {
        /// Width and height.
        size: [usize; 2],
        /// Shortest side that will do.
        least: usize,
    },
    /// A network cannot be used.
    #[error(transparent)]
    Network(#[from] veiloc_features::FeatureError),
}
