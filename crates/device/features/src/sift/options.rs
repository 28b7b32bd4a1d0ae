//! What can be chosen in an extraction.

/// How keypoints are found and described.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SiftOptions {
    /// At most this many keypoints, the strongest. Default 4096, the largest size class of a query.
    pub max_keypoints: usize,
    /// Doubles the image first. Default true: about three times as many keypoints, four times the work.
    pub upsample: bool,
    /// The least |difference of Gaussians| at a keypoint, for samples in [0, 1]. Default 0.004; COLMAP's 0.02 / 3 finds
    /// fewer indoors and gives a seventh fewer correct matches there (research/notes/features.md).
    pub peak_threshold: f32,
    /// The largest ratio of principal curvatures; beyond it a keypoint is on an edge. Default 10, Lowe's.
    pub edge_threshold: f32,
    /// At most this many keypoints at one place, one for each strong gradient direction. Default 2, COLMAP's.
    pub max_orientations: usize,
    /// At most this many octaves. Default 16: until the image is smaller than a descriptor.
    pub max_octaves: usize,
    /// What keypoints near the image's border are described by. Default [`Border::Cut`].
    pub border: Border,
}

/// What a keypoint whose patch reaches over the image's border is described by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Border {
    /// By the gradients inside the image, as OpenCV and COLMAP do: cells outside are empty, and show the border.
    #[default]
    Cut,
    /// By the image continued by its mirror image: what is sent of a device's images, which must not show the border (rule
    /// L11 of docs/reference/privacy-rules.md).
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
