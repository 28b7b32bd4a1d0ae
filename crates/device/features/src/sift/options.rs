//! Options of an extraction.

/// How keypoints are found and described.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SiftOptions {
    /// At most this many keypoints, the strongest. Default 4096, the largest size class of a query.
    pub max_keypoints: usize,
    /// Whether the image is doubled first. Default true: about three times as many keypoints, four times the work.
    pub upsample: bool,
    /// Minimum |difference of Gaussians| of a keypoint, for samples in [0, 1]. Default 0.004; COLMAP's 0.02 / 3 finds
    /// fewer keypoints indoors and a seventh fewer correct matches there (docs/results/features.md).
    pub peak_threshold: f32,
    /// The largest ratio of principal curvatures; beyond it a keypoint is on an edge. Default 10, Lowe's.
    pub edge_threshold: f32,
    /// Maximum number of keypoints at one position, one per strong gradient direction. Default 2, COLMAP's.
    pub max_orientations: usize,
    /// Maximum number of octaves. Default 16: until the image is smaller than a descriptor.
    pub max_octaves: usize,
    /// How keypoints near the image's border are described. Default [`Border::Cut`].
    pub border: Border,
}

/// How a keypoint whose patch crosses the image's border is described.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Border {
    /// From the gradients inside the image, as in OpenCV and COLMAP: cells outside are empty, and show the border.
    #[default]
    Cut,
    /// From the image continued by its mirror image: used for sealing, where the border must not show (rule L11 of
    /// docs/reference/privacy-rules.md).
    Mirrored,
}

impl Default for SiftOptions {
    fn default() -> Self {
        Self {
            max_keypoints: 4096,
            upsample: true,
            peak_threshold: 0.004,
            edge_threshold: 10.0,
            max_orientations: 2,
            max_octaves: 16,
            border: Border::Cut,
        }
    }
}
