//! Why a map could not be built or changed. Every message names the file and says what to do.

use veiloc_descriptor::DescriptorError;
use veiloc_features::FeatureError;
use veiloc_map::MapError;
use veiloc_query::QueryError;

/// Why a map could not be built or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// No image was named.
    #[error("the list of images is empty; name at least one")]
    EmptyList,
    /// An image was named twice.
    #[error("{name} is in the list twice; name every image once")]
    DuplicateName {
        /// Its name.
        name: String,
    },
    /// An image that was named has no pose.
    #[error(
        "{name} is in the list, but the posed model has no pose for it; take it from the list or add its pose"
    )]
    NoPose {
        /// Its name.
        name: String,
    },
    /// An image that is to join is already there.
    #[error("{name} is already in the map; remove it first to replace it")]
    AlreadyInMap {
        /// Its name.
        name: String,
    },
    /// An image that is to leave is not there.
    #[error("{name} is not in the map, so it cannot be removed; names are those of the posed model")]
    NotInMap {
        /// Its name.
        name: String,
    },
    /// An image could not be read.
    #[error(transparent)]
    Image(#[from] FeatureError),
    /// The map's global descriptors are made of images, by an extractor that is not here.
    #[error(
        "the map's global descriptors are made of the images by {name}, which this program does not have"
    )]
    GlobalOfImage {
        /// The extractor's name.
        name: String,
    },
    /// Nothing to recognise was found in any image.
    #[error("no usable keypoints in {images} images: {source}; are they blank, or not the right files?")]
    NoKeypoints {
        /// How many there were.
        images: usize,
        /// What the vocabulary lacks.
        source: DescriptorError,
    },
    /// No point of the place could be triangulated.
    #[error(
        "no point could be triangulated from {images} images ({matches} matches, {verified} of them agree with \
         the poses); do the images overlap, from different places, and are the poses world-to-camera?"
    )]
    NoPoints {
        /// How many images.
        images: usize,
        /// Matches by descriptors.
        matches: usize,
        /// Those that agree with the poses.
        verified: usize,
    },
    /// The model that is to be imported has nothing to import.
    #[error(
        "the COLMAP model has {points} points, and no keypoint found in the images lies near any of their \
         observations; are these the images of the model? To make points from poses alone, build a map instead"
    )]
    NothingImported {
        /// Points of the model.
        points: usize,
    },
    /// An option is out of its range.
    #[error("option {option} is {value}; allowed is {allowed}")]
    Option {
        /// Its name.
        option: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The limits for devices are out of range.
    #[error(transparent)]
    Profile(#[from] QueryError),
    /// The map does not hold together.
    #[error(transparent)]
    Map(#[from] MapError),
}
