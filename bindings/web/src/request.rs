//! The calls, as the loader writes them.

use serde::{Deserialize, Serialize};
use veiloc_ar::FrameworkPose;

/// One call. Brackets name its payload.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase", deny_unknown_fields)]
pub enum Request {
    /// Stores a profile [its bytes].
    Profile,
    /// Starts a session [32 random bytes].
    Session {
        /// `world`, `gravity` or `image`; see `SessionAnchors`.
        #[serde(default)]
        anchors: Option<String>,
    },
    /// Resumes a session [its bytes].
    SessionFrom,
    /// Returns the bytes of a session.
    SessionBytes {
        /// Handle of the session.
        session: u32,
    },
    /// The camera of a JPEG or PNG file from its EXIF focal length, with the rule of `veiloc seal` [the file's bytes].
    Exif {
        /// Columns of the decoded image.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Reads a network that finds people [the bytes of its TFLite file].
    Segmenter,
    /// Makes a sealer [the bytes of the pack, where it has one].
    Sealer(Sealer),
    /// Extracts the features of an image [red, green, blue, alpha of each pixel].
    Extract(Box<Extract>),
    /// Seals the features of an image, and forgets them [32 random bytes].
    Seal {
        /// Handle of the sealer.
        sealer: u32,
        /// Handle of the features.
        extracted: u32,
        /// Handle of the session that the image belongs to.
        #[serde(default)]
        session: Option<u32>,
    },
    /// Returns the first rows of a query, as bytes to send.
    Step {
        /// Handle of the query.
        query: u32,
        /// Number of rows, one of the steps that `seal` returned.
        rows: usize,
    },
    /// Returns the lines of a query, and the keypoints they hide.
    Show {
        /// Handle of the query.
        query: u32,
    },
    /// Returns a query with the keypoints it hides, for an attack in another worker of this device. It must not be
    /// sent.
    Exhibit {
        /// Handle of the query.
        query: u32,
    },
    /// Attacks an exhibit [its bytes]. The call needs no state, so any worker can run it.
    Attack {
        /// One of `inspection::ATTACKS`.
        attack: String,
        /// As in the reply to `Exhibit`.
        query_bytes: usize,
    },
    /// Begins an alignment of an AR world with the map.
    Alignment {
        /// Of the map; `None` for the unit that the answers state.
        #[serde(default)]
        metres_per_unit: Option<f64>,
    },
    /// Adds an answer to an alignment [its JSON].
    AlignmentAdd {
        /// Handle of the alignment.
        alignment: u32,
        /// Of the camera in the AR world when it took the image.
        pose: Pose,
    },
    /// Tells an alignment where the camera is between answers.
    AlignmentMoved {
        /// Handle of the alignment.
        alignment: u32,
        /// Of the camera in the AR world.
        pose: Pose,
    },
    /// Returns the pose in the AR world of content in the map.
    WorldFromAnchor {
        /// Handle of the alignment.
        alignment: u32,
        /// Of the content in the map, map units.
        pose: Pose,
    },
    /// Returns the pose of the camera in the map, map units.
    CameraInMap {
        /// Handle of the alignment.
        alignment: u32,
        /// Of the camera in the AR world.
        pose: Pose,
    },
    /// Frees the object of a handle.
    Free {
        /// The handle.
        handle: u32,
    },
}

/// What the device decides.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Sealer {
    /// Handle of the profile.
    pub profile: u32,
    /// As `--scheme` of `veiloc seal`; `None` for `dcl`. `points` is refused.
    #[serde(default)]
    pub scheme: Option<String>,
    /// Bits of each quantized angle; `None` for the default.
    #[serde(default)]
    pub angle_bits: Option<u8>,
    /// Most keypoints to send; `None` for the number that the profile requests, within the device's limits.
    #[serde(default)]
    pub max_keypoints: Option<usize>,
    /// Longest side to which the image is scaled down, pixels; `None` for the device's limit.
    #[serde(default)]
    pub max_image_side: Option<u32>,
    /// Whether `down` of an image is sent; `None` for yes.
    #[serde(default)]
    pub send_gravity: Option<bool>,
    /// Whether the payload is a pack: nothing is sent that the place does not know.
    #[serde(default)]
    pub pack: bool,
    /// What is sent with a pack, `matches` or `explained`; `None` for matches.
    #[serde(default)]
    pub send: Option<String>,
}

/// An image, its camera, and its orientation.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Extract {
    /// Handle of the sealer.
    pub sealer: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// COLMAP camera, `MODEL,W,H,PARAMS…`; `None` guesses the focal length and marks it as unknown in the query.
    #[serde(default)]
    pub camera: Option<String>,
    /// Whether the camera is one that `Exif` returned.
    #[serde(default)]
    pub exif: bool,
    /// Orientation of the camera, a quaternion `w x y z` from a fixed world frame.
    #[serde(default)]
    pub orientation: Option<[f64; 4]>,
    /// Down direction in the camera frame.
    #[serde(default)]
    pub down: Option<[f64; 3]>,
    /// Its standard deviation, degrees; `None` for that of tracking.
    #[serde(default)]
    pub down_sd_deg: Option<f64>,
    /// Of which pixels nothing is sent; its bytes follow those of the image.
    #[serde(default)]
    pub mask: Option<Mask>,
    /// Handle of a segmenter: the people that it finds are hidden, too.
    #[serde(default)]
    pub people: Option<u32>,
    /// Degrees clockwise by which the image is turned to stand upright; needed for people only.
    #[serde(default)]
    pub turn: i32,
}

/// A mask, a byte a pixel.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Mask {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Which values hide: `marked` (all but 0), `confidence` (51 and more), `arcore-semantics` (9 and 10) or `dark-hides` (below 128).
    pub kind: String,
    /// As a share of the longer side; `None` for the default.
    #[serde(default)]
    pub margin: Option<f32>,
}

/// A pose as WebXR's `XRRigidTransform` states it: `y` up, cameras look along `-z`, metres.
#[derive(Debug, Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// In the world.
    pub position: [f64; 3],
    /// Quaternion `x y z w`, from the object's axes to the world's.
    pub orientation: [f64; 4],
}

impl From<Pose> for FrameworkPose {
    fn from(Pose { position, orientation }: Pose) -> Self {
        Self { position, rotation: orientation }
    }
}

impl From<FrameworkPose> for Pose {
    fn from(FrameworkPose { position, rotation }: FrameworkPose) -> Self {
        Self { position, orientation: rotation }
    }
}
