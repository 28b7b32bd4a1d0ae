//! What can be wrong with the input of an attack, with a network and its training, or with images that are compared.

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
    /// Training left the numbers that can be computed with.
    #[error("the loss of step {step} is not finite; a smaller learning rate may help")]
    Diverged {
        /// Step, from 0.
        step: usize,
    },
    /// The bytes do not begin as such a file does.
    #[error("this is no {expected}")]
    NotANetwork {
        /// What was to be read, and what writes it.
        expected: &'static str,
    },
    /// The file is of another version.
    #[error("the file is of version {found}, this program reads version {expected}; train again")]
    Version {
        /// The version in the file.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file is cut short, or too long.
    #[error("the file has {found} bytes, {expected} are expected; copy it again")]
    Length {
        /// Bytes that are there.
        found: usize,
        /// Bytes that such a file has.
        expected: u64,
    },
    /// The bytes are not those that were written.
    #[error("the file is damaged (checksum); copy it again")]
    Checksum,
    /// A learned number is not finite.
    #[error("the file holds a number that is not finite; train again")]
    NotFinite,
    /// A training cannot go on with other options or images than it began with.
    #[error("the training that is to go on was begun with other options or images; begin anew without it")]
    OtherTraining,
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
