//! What can be asked, as the loader writes it.

use serde::Deserialize;

/// One call. Bytes behind the head are named in brackets.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase", deny_unknown_fields)]
pub enum Request {
    /// Keeps a profile [its bytes].
    Profile,
    /// Begins a session [32 random bytes].
    Session {
        /// `world`, `gravity` or `image`; see `SessionAnchors`.
        #[serde(default)]
        anchors: Option<String>,
    },
    /// Goes on with a session [its bytes].
    SessionFrom,
    /// The bytes of a session.
    SessionBytes {
        /// Its handle.
        session: u32,
    },
    /// Seals an image [32 random bytes, then red, green, blue, alpha of each pixel].
    Seal(Box<Seal>),
    /// The first rows of a query, as bytes to send.
    Step {
        /// Its handle.
        query: u32,
        /// How many, one of those that `seal` named.
        rows: usize,
    },
    /// What a query tells: its lines, and the keypoints they hide.
    Show {
        /// Its handle.
        query: u32,
    },
    /// A query and the keypoints it hides, for another worker of this device to attack: to be sent to nobody.
    Exhibit {
        /// Its handle.
        query: u32,
    },
    /// What an attack makes of an exhibit [its bytes]. Nothing is kept, so any worker can be asked.
    Attack {
        /// One of `shown::ATTACKS`.
        attack: String,
        /// As `Exhibit` told it.
        query_bytes: usize,
    },
    /// Gives back what is kept under a handle.
    Free {
        /// It.
        handle: u32,
    },
}

/// An image to seal.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Seal {
    /// Handle of the profile.
    pub profile: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// As COLMAP writes it, `MODEL,W,H,PARAMS…`; `None` guesses the focal length and says so.
    #[serde(default)]
    pub camera: Option<String>,
    /// As `--scheme` of `veiloc seal`; `None` for `dcl`. Points are not sealed here.
    #[serde(default)]
    pub scheme: Option<String>,
    /// Bits of an angle; `None` for the default.
    #[serde(default)]
    pub angle_bits: Option<u8>,
    /// Most keypoints that are sent; `None` for what the profile asks for within the device's limits.
    #[serde(default)]
    pub max_keypoints: Option<usize>,
    /// The session it is a frame of.
    #[serde(default)]
    pub session: Option<u32>,
    /// How the camera was held, a quaternion `w x y z` from a frame that stays in the world.
    #[serde(default)]
    pub orientation: Option<[f64; 4]>,
    /// Where things fall, in the camera's axes.
    #[serde(default)]
    pub down: Option<[f64; 3]>,
}
