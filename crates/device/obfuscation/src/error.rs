//! Why nothing could be extracted from an image, or it could not be sealed, and what to do about it.

use veiloc_features::FeatureError;
use veiloc_protocol::QueryError;

/// Why nothing was sealed. Holds counts and indices, never positions.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SealError {
    /// A keypoint whose position is not a number.
    #[error("keypoint {index} has a position that is not finite; the extractor that made it is faulty")]
    NotFinite {
        /// Its index in the input.
        index: usize,
    },
    /// A position further from the centre of the image than the wire format can tell.
    #[error(
        "keypoint {index} is more than 8191 px from the centre of the image; extract from a smaller image"
    )]
    TooFar {
        /// Its index in the input.
        index: usize,
    },
    /// Not one descriptor for each keypoint.
    #[error("{keypoints} keypoints but {descriptors} descriptors; both must come from one extraction")]
    Unpaired {
        /// Number of keypoints.
        keypoints: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// No keypoint is usable.
    #[error(
        "no usable keypoint among {extracted}: the image shows no texture, or the camera parameters are not \
         those of this image; take another image or check the camera"
    )]
    NoKeypoints {
        /// How many there were.
        extracted: usize,
    },
    /// All keypoints belong to one anchor, whose lines alone do not fix a pose.
    #[error(
        "all {keypoints} keypoints lie on one side of the dividing line, which leaves the pose undetermined; \
         turn the camera so that both sides show texture, or turn the dividing line (dcl:horizontal)"
    )]
    OneSided {
        /// How many there are.
        keypoints: usize,
    },
    /// `points` was asked for where a scheme that protects is expected.
    #[error(
        "the scheme points sends positions as they are; ask for it by its own name (SealOptions::unprotected_points)"
    )]
    Unprotected,
    /// The profile's vocabulary is larger than the device allows.
    #[error(
        "the profile has a vocabulary of {words} words, this device takes {allowed}; an operator has no need of more"
    )]
    VocabularyTooLarge {
        /// How many it has.
        words: usize,
        /// How many are taken.
        allowed: usize,
    },
    /// The profile asks for a global descriptor that is made of the image and not of the rows that are sent.
    #[error(
        "the profile asks for a global descriptor of the image ({name}, {codes} numbers), which tells of more than the rows \
         that are sent; this device's owner did not consent to that very one"
    )]
    GlobalOfImage {
        /// Its name.
        name: String,
        /// How many numbers it has.
        codes: usize,
    },
    /// The owner consented to a global descriptor of the image, and the features come without one.
    #[error(
        "the features come without the global descriptor of their image; extract them with the options they are sealed with"
    )]
    NoGlobal,
    /// There are too few keypoints, and decoys cannot be made.
    #[error(
        "{keypoints} keypoints are too few, and no decoys can be made of descriptors of kind {kind} to fill the query \
         up; take an image with more texture"
    )]
    NoDecoys {
        /// The descriptor kind.
        kind: String,
        /// Usable keypoints.
        keypoints: usize,
    },
    /// The layout of a session would have to be put somewhere new once too often.
    #[error(
        "{starts} images of this place were sealed with anchors of their own, and {most} is the most: the lines of more cross in \
         the keypoints. Tell how the camera was held (an orientation), or go to another place and begin another session"
    )]
    TooManyStarts {
        /// How many there were.
        starts: u32,
        /// How many are allowed.
        most: u32,
    },
    /// The camera has turned so far from where the session's layout is that what is new lies on one side.
    #[error(
        "the camera has turned away from the session's anchors, and of what was not sent before only {few} keypoints lie on one \
         side of the dividing line; turn on or back, or seal with a layout of sectors"
    )]
    TurnedAway {
        /// How many.
        few: usize,
    },
    /// A scheme without anchors in a session whose anchors stay in the world.
    #[error("the scheme {scheme} has no anchors that could stay in the world; seal as dcl")]
    SessionScheme {
        /// Its name.
        scheme: &'static str,
    },
    /// Frames of one session must have one layout and one camera.
    #[error("another {what} than that of the session's frames before; begin another session")]
    SessionChanged {
        /// What is not as before.
        what: &'static str,
    },
    /// Anchors are tied to gravity, and the frame does not tell it.
    #[error("the session's anchors are tied to gravity, and the frame does not say which way is down")]
    NoGravity,
    /// An orientation that is no rotation.
    #[error("the orientation is no rotation of finite numbers")]
    NoOrientation,
    /// The operating system gave no random numbers.
    #[error("the operating system gave no random numbers ({reason}); without them nothing can be sealed")]
    NoEntropy {
        /// What the system said.
        reason: String,
    },
    /// Bytes that are no session.
    #[error("this is no session of veiloc")]
    NotASession,
    /// A session of another version of the format.
    #[error("a session of version {found}, but this program reads version {supported}; begin a new session")]
    SessionVersion {
        /// The one it has.
        found: u32,
        /// The one this program reads.
        supported: u32,
    },
    /// A session that was cut off, changed, or put together by somebody else.
    #[error("the session is damaged ({what})")]
    SessionDamaged {
        /// Where.
        what: &'static str,
    },
    /// The file is no image that can be read, it is not of the camera's size, or no extractor makes what is asked for.
    #[error(transparent)]
    Image(#[from] FeatureError),
    /// Camera, profile and features do not go together.
    #[error(transparent)]
    Query(#[from] QueryError),
}
