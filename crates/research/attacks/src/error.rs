//! Errors of attacks, of their networks and of image comparisons.

/// Why an attack, a network or an image comparison was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AttackError {
    /// The number of neighbour lists differs from the number of observations.
    #[error(
        "{lists} neighbour lists were given for {observations} observations; give one list per observation"
    )]
    ListCount {
        /// Number of observations.
        observations: usize,
        /// Number of neighbour lists.
        lists: usize,
    },
    /// A neighbour list names an observation that does not exist.
    #[error("neighbour list {list} names observation {index}, but there are only {observations}")]
    UnknownNeighbour {
        /// Which list.
        list: usize,
        /// The index it names.
        index: u32,
        /// Number of observations.
        observations: usize,
    },
    /// The offsets of the lists do not start at 0, shrink, or do not end at the number of entries.
    #[error("neighbour list offsets must rise from 0 to the number of entries, {entries}")]
    Offsets {
        /// Number of entries.
        entries: usize,
    },
    /// The number of bytes is not a multiple of the descriptor's length.
    #[error("{bytes} bytes is not a multiple of the descriptor length, {dimension}")]
    Descriptors {
        /// Number of bytes.
        bytes: usize,
        /// Length of one descriptor.
        dimension: usize,
    },
    /// The numbers of descriptors and keypoints differ.
    #[error(
        "{descriptors} descriptors were given for {keypoints} keypoints; give one descriptor per keypoint"
    )]
    DescriptorCount {
        /// Number of keypoints.
        keypoints: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// Descriptors that are compared have different dimensions.
    #[error("descriptors have dimension {found}, but dimension {expected} is required")]
    Dimensions {
        /// The dimension expected.
        expected: usize,
        /// The dimension found.
        found: usize,
    },
    /// No keypoint has a neighbour, and the attack needs neighbours.
    #[error("no keypoint has a neighbour; give at least one neighbour per keypoint")]
    NoNeighbours,
    /// The numbers of initial positions and observations differ.
    #[error(
        "{positions} initial positions were given for {observations} observations; give one per observation"
    )]
    InitialPositionCount {
        /// Number of observations.
        observations: usize,
        /// Number of positions.
        positions: usize,
    },
    /// In one frame the numbers of descriptors and observations differ.
    #[error(
        "frame {frame}: {descriptors} descriptors were given for {observations} observations; give one per observation"
    )]
    FrameDescriptors {
        /// Which frame, the attacked one being 0.
        frame: usize,
        /// Number of observations.
        observations: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// Fewer than two frames were given to an attack on several frames.
    #[error("an attack on several frames needs at least two, {frames} were given")]
    TooFewFrames {
        /// Number of frames.
        frames: usize,
    },
    /// Several seals of one image have different numbers of rows.
    #[error("{rows} rows were given, but the first seal has {expected}; give one entry per row")]
    Rows {
        /// Number of rows.
        rows: usize,
        /// Number of rows of the first seal.
        expected: usize,
    },
    /// The depth limits are not an interval of positive, finite numbers.
    #[error("depth limits must be positive, finite and in increasing order")]
    Depths,
    /// The training images hold no two keypoints that are neighbours.
    #[error("the training images hold no pair of neighbours")]
    NothingToLearn,
    /// The scheme sends positions, so there is nothing to attack, or the network was trained for another scheme.
    #[error("{found}: {expected}")]
    Scheme {
        /// What was given.
        found: String,
        /// What is accepted.
        expected: String,
    },
    /// Two images have different sizes.
    #[error("images of {}x{} and {}x{} pixels cannot be compared; resize them to one size", sizes[0][0], sizes[0][1], sizes[1][0], sizes[1][1])]
    Sizes {
        /// Width and height of each.
        sizes: [[u32; 2]; 2],
    },
    /// An image has a side that is shorter than the window.
    #[error("an image of {}x{} pixels is too small: each side must have {least}", size[0], size[1])]
    Small {
        /// Width and height.
        size: [usize; 2],
        /// Smallest accepted side.
        least: usize,
    },
    /// An option, or a number in a file, is outside its allowed range.
    #[error("{name} is {value}; allowed: {allowed}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        allowed: &'static str,
    },
    /// The file does not describe an attacker's network, or describes a network of another kind.
    #[error(
        "{}: the file does not describe the required network: {reason}; give the .toml that research/train writes \
         beside the .onnx",
        path.display()
    )]
    Description {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The scheme cannot obfuscate an image.
    #[cfg(feature = "networks")]
    #[error(transparent)]
    Seal(#[from] veiloc_obfuscation::SealError),
    /// A network cannot be read or run.
    #[cfg(feature = "networks")]
    #[error(transparent)]
    Features(#[from] veiloc_features::FeatureError),
}

/// Compares the facts of two errors; messages of the operating system cannot be compared.
impl PartialEq for AttackError {
    fn eq(&self, other: &Self) -> bool {
        format!("{self:?}") == format!("{other:?}")
    }
}
