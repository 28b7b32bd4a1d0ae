//! What can be wrong with the input of an attack, with a network, or with images that are compared.

/// Why an attack refused its input, or there is no network or no measure of images.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AttackError {
    /// There is not one neighbour list per observation.
    #[error("{observations} observations need as many neighbour lists, {lists} were given")]
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
    /// The bytes are no whole number of descriptors.
    #[error("{bytes} bytes are no whole number of descriptors of dimension {dimension}")]
    Descriptors {
        /// Number of bytes.
        bytes: usize,
        /// Length of one descriptor.
        dimension: usize,
    },
    /// There is not one descriptor per keypoint.
    #[error("{keypoints} keypoints need as many descriptors, {descriptors} were given")]
    DescriptorCount {
        /// Number of keypoints.
        keypoints: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// Descriptors that are compared have different dimensions.
    #[error("descriptors of dimension {expected} are expected, these have {found}")]
    Dimensions {
        /// The dimension expected.
        expected: usize,
        /// The dimension found.
        found: usize,
    },
    /// No keypoint has any neighbour, and the attack lives on neighbours.
    #[error("no keypoint has any neighbour; ask for one at least")]
    NoNeighbours,
    /// There is not one position to begin with per observation.
    #[error("{observations} observations need as many positions to begin with, {positions} were given")]
    BeginCount {
        /// Number of observations.
        observations: usize,
        /// Number of positions.
        positions: usize,
    },
    /// A frame holds another number of descriptors than of observations.
    #[error("frame {frame}: {observations} observations need as many descriptors, {descriptors} were given")]
    FrameDescriptors {
        /// Which frame, the attacked one being 0.
        frame: usize,
        /// Number of observations.
        observations: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// Several frames were asked for, and fewer than two given.
    #[error("several frames are two at least, {frames} were given")]
    TooFewFrames {
        /// How many there are.
        frames: usize,
    },
    /// Several seals of one image have not as many rows.
    #[error("{rows} rows, where the first seal has {expected}")]
    Rows {
        /// How many there are.
        rows: usize,
        /// How many the first has.
        expected: usize,
    },
    /// Limits of depth are no interval of positive, finite numbers.
    #[error("depths must be positive, finite and in order")]
    Depths,
    /// The training images hold no two keypoints that are neighbours.
    #[error("the training images hold no pair of neighbours")]
    NothingToLearn,
    /// There is nothing to learn or to attack where positions are sent, or nothing but one scheme was learned.
    #[error("{found}: {expected}")]
    Scheme {
        /// What was given.
        found: String,
        /// What would do.
        expected: String,
    },
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
    /// An option, or a number in a file, is none of those allowed.
    #[error("{name} is {value}, allowed is {allowed}")]
    Option {
        /// Which.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// A file that does not describe a network of an attacker, or one of another kind.
    #[error(
        "{}: this does not describe the network that is needed: {reason}; give the .toml that research/train writes \
         beside the .onnx",
        path.display()
    )]
    Description {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// An image cannot be obfuscated under the scheme.
    #[cfg(feature = "networks")]
    #[error(transparent)]
    Seal(#[from] veiloc_obfuscation::SealError),
    /// A network cannot be used.
    #[cfg(feature = "networks")]
    #[error(transparent)]
    Features(#[from] veiloc_features::FeatureError),
}

impl AttackError {
    /// What is wrong with a whole number.
    pub fn refuse(name: &'static str, value: usize, allowed: &'static str) -> Self {
        Self::Option { name, value: value as f64, allowed }
    }
}

/// Equal when they say the same facts: what the system said of a file cannot be compared otherwise.
impl PartialEq for AttackError {
    fn eq(&self, other: &Self) -> bool {
        format!("{self:?}") == format!("{other:?}")
    }
}
