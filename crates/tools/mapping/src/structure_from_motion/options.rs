//! Options of structure from motion.

use std::path::PathBuf;

/// Images up to which all pairs are matched.
pub const MAX_EXHAUSTIVE: usize = 300;

/// Which pairs of images are matched.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SfmMatching {
    /// All pairs of up to [`MAX_EXHAUSTIVE`] images, and of more images if their names are not numbered; otherwise
    /// as for frames of a video.
    #[default]
    Auto,
    /// All pairs.
    Exhaustive,
    /// Neighbours by name, as for frames of a video, and all pairs of some hundred frames.
    Sequential,
}

/// Options of structure from motion.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct SfmOptions {
    /// The Python with pycolmap. Default: `python3` of the PATH if it has pycolmap, or else the program `colmap` of the
    /// PATH.
    pub python: Option<PathBuf>,
    /// Which pairs are matched.
    pub matching: SfmMatching,
    /// Seed of its random choices.
    pub seed: u64,
    /// All images that are twice as wide as high are equirectangular panoramas. Those whose metadata says so always are.
    pub are_panoramas: bool,
    /// Leave out images that cannot be decoded.
    pub skip_bad: bool,
}
