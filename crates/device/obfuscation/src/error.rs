//! Why an image could not be extracted or sealed, and what to do about it.

use veiloc_features::FeatureError;
use veiloc_protocol::{QueryError, UnbalancedAnchors};

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
    /// A position that is farther from the image's centre than the wire format can express.
    #[error(
        "keypoint {index} is more than 8191 px from the centre of the image; extract from a smaller image"
    )]
    TooFar {
        /// Its index in the input.
        index: usize,
    },
    /// The numbers of keypoints and descriptors differ.
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
    /// The options allow no keypoint.
    #[error("max_keypoints is 0, and a query needs keypoints; give at least 256, the smallest size class")]
    NoneAllowed,
    /// All keypoints belong to one anchor, whose lines alone do not fix a pose.
    #[error(
        "all {keypoints} keypoints lie on one side of the dividing line, which leaves the pose undetermined; \
         turn the camera so that both sides show texture, or turn the dividing line (dcl:horizontal)"
    )]
    OneSided {
        /// How many there are.
        keypoints: usize,
    },
    /// Too few rows on one side of the dividing line, where only queries that can determine a pose are sealed.
    #[error(transparent)]
    Unbalanced(#[from] UnbalancedAnchors),
    /// `points` was requested where a scheme that hides positions is required.
    #[error(
        "the scheme points sends positions unprotected; if that is intended, use SealOptions::unprotected_points"
    )]
    Unprotected,
    /// The scheme is `dcl:random`, which is for tables of attacks.
    #[error("the scheme dcl:random is for tables of attacks; seal with dcl")]
    OnlyForTables,
    /// The profile's vocabulary is larger than the device allows.
    #[error(
        "the profile has a vocabulary of {words} words, this device accepts at most {allowed}; build the map with a \
         smaller vocabulary"
    )]
    VocabularyTooLarge {
        /// How many it has.
        words: usize,
        /// How many are accepted.
        allowed: usize,
    },
    /// The profile requests a global descriptor that is computed from the image and not from the rows that are sent.
    #[error(
        "the profile requests a global descriptor of the image ({name}, {codes} numbers), which reveals more than the \
         rows that are sent; the owner of this device did not consent to sending this model's descriptor"
    )]
    GlobalOfImage {
        /// Its name.
        name: String,
        /// How many numbers it has.
        codes: usize,
    },
    /// The owner consented to a global descriptor of the image, but the features come without one.
    #[error(
        "the features come without the global descriptor of their image; extract them with the sealer that seals them"
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
    /// Hardly anything in the image is of the place whose pack the device has.
    #[error(
        "{matching} of {extracted} keypoints match the place: the image does not show this place, or in other light or \
         season; nothing was sealed"
    )]
    NotThisPlace {
        /// How many probably match.
        matching: usize,
        /// Keypoints of the image.
        extracted: usize,
    },
    /// Packs are used with SIFT and compact descriptors.
    #[error("a pack of {kind} descriptors cannot be used: there is a background for sift and compact only")]
    PackKind {
        /// The descriptor kind.
        kind: String,
    },
    /// The pack is of another map than the profile.
    #[error("the pack is of another map than the profile; fetch both again")]
    PackOfOtherMap,
    /// The pack is larger than the device allows.
    #[error("the pack has {rows} rows, this device accepts at most {allowed}; use the pack of a region")]
    PackTooLarge {
        /// How many it has.
        rows: usize,
        /// How many are accepted.
        allowed: usize,
    },
    /// The layout of a session would have to be placed anew more often than is allowed.
    #[error(
        "{starts} images of this scene were sealed with different anchors, and at most {most} are allowed: the lines of \
         more images cross in the keypoints. Give the camera's orientation, or begin another session in another scene"
    )]
    TooManyStarts {
        /// How often the layout was placed for this scene.
        starts: u32,
        /// How often it may be placed.
        most: u32,
    },
    /// The camera has turned so far from the session's layout that nearly all new keypoints belong to one anchor.
    #[error(
        "the camera has turned away from the session's anchors, and only {few} new keypoints lie on one side of the \
         dividing line; turn the camera on or back, or seal with a layout of sectors"
    )]
    TurnedAway {
        /// How many.
        few: usize,
    },
    /// A scheme without anchors in a session whose anchors are fixed in the world.
    #[error("the scheme {scheme} has no anchors that could be fixed in the world; seal with dcl")]
    SessionScheme {
        /// Its name.
        scheme: &'static str,
    },
    /// All frames of a session must have the same layout and camera.
    #[error("the {what} differs from that of the session's earlier frames; begin another session")]
    SessionChanged {
        /// What differs.
        what: &'static str,
    },
    /// Anchors are tied to gravity, but the frame gives no gravity direction.
    #[error(
        "the session's anchors are tied to gravity, but the frame gives no gravity direction; give it with the \
         orientation"
    )]
    NoGravity,
    /// The given orientation is not a rotation.
    #[error("the orientation is not a rotation with finite numbers")]
    NoOrientation,
    /// The operating system gave no random numbers.
    #[error("the operating system gave no random numbers ({reason}); sealing needs them")]
    NoEntropy {
        /// The message of the system.
        reason: String,
    },
    /// The bytes are not a session.
    #[error("this is not a session of veiloc")]
    NotASession,
    /// A session of another version of the format.
    #[error(
        "the session has version {found}, but this program reads version {supported}; begin a new session"
    )]
    SessionVersion {
        /// Its version.
        found: u32,
        /// The version that this program reads.
        supported: u32,
    },
    /// A session that was truncated, changed, or not written by this program.
    #[error("the session is damaged ({what})")]
    SessionDamaged {
        /// Which part.
        what: &'static str,
    },
    /// The file is not a readable image, it does not have the camera's size, or no extractor makes the requested kind.
    #[error(transparent)]
    Image(#[from] FeatureError),
    /// Camera, profile and features do not fit together.
    #[error(transparent)]
    Query(#[from] QueryError),
}

/// What an app does about a [`SealError`]; the names are those of the bindings for browsers, C and phones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum SealErrorKind {
    /// The image or its camera cannot be used.
    Image,
    /// The image shows too little texture, or on one side only: take another image.
    Texture,
    /// The query could not determine a pose: take another image.
    Unbalanced,
    /// Hardly anything in the image is of the place: point the camera at the place.
    NotThisPlace,
    /// The bytes are not a session, or damaged: begin a new one.
    Session,
    /// The session would have to be placed anew too often: walk on, and show another view.
    TooManyStarts,
    /// The camera turned away from the session's anchors: turn on or back.
    TurnedAway,
    /// The caller stopped it.
    Stopped,
    /// Anything else: the profile, the options, or features that do not fit.
    Seal,
}

impl SealErrorKind {
    /// The name for programs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Texture => "texture",
            Self::Unbalanced => "unbalanced",
            Self::NotThisPlace => "not-this-place",
            Self::Session => "session",
            Self::TooManyStarts => "too-many-starts",
            Self::TurnedAway => "turned-away",
            Self::Stopped => "stopped",
            Self::Seal => "seal",
        }
    }
}

impl SealError {
    /// What an app does about it.
    pub const fn kind(&self) -> SealErrorKind {
        match self {
            Self::Image(FeatureError::Stopped) => SealErrorKind::Stopped,
            Self::Image(_) => SealErrorKind::Image,
            Self::NoKeypoints { .. } | Self::OneSided { .. } | Self::NoDecoys { .. } => {
                SealErrorKind::Texture
            }
            Self::Unbalanced(_) => SealErrorKind::Unbalanced,
            Self::NotThisPlace { .. } => SealErrorKind::NotThisPlace,
            Self::NotASession | Self::SessionVersion { .. } | Self::SessionDamaged { .. } => {
                SealErrorKind::Session
            }
            Self::TooManyStarts { .. } => SealErrorKind::TooManyStarts,
            Self::TurnedAway { .. } => SealErrorKind::TurnedAway,
            _ => SealErrorKind::Seal,
        }
    }
}
