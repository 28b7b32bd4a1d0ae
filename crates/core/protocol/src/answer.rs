//! What a server answers: the pose, its uncertainty, and whether to trust it.
//!
//! [`Answer::encode`] and [`Answer::decode`] write and read it (`answer_wire.rs`).

use std::fmt;

use serde::{Deserialize, Serialize};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};

/// State of an answer. A query without a pose gets an error response instead of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AnswerState {
    /// Nothing speaks against the pose.
    Trusted,
    /// There is a pose, and at least one [`AnswerDoubt`].
    Doubtful,
}

impl AnswerState {
    /// The name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
        }
    }
}

impl fmt::Display for AnswerState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Where a sealed query was taken, according to the server.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The pose; `None` when it is doubtful and the request excluded doubtful poses.
    pub pose: Option<AnswerPose>,
    /// Reasons not to trust the pose; none for a trusted one.
    pub doubts: Vec<AnswerDoubt>,
    /// Natural logarithm of the evidence against chance.
    pub log_evidence: f64,
    /// Log likelihood by which the pose beats the best other one; infinite when no other was found.
    pub margin: f64,
    /// How well the query fits the pose; `None` when the service does not report it.
    pub fit: Option<AnswerFit>,
    /// Whether the gravity direction of the query was used.
    pub gravity: GravityUse,
    /// What the coordinates of the map mean.
    pub map: MapCoordinates,
    /// Rows of the query that agree with the pose.
    pub inliers: u32,
    /// Rows of the query that were matched to map points, to one or several.
    pub matches: u32,
    /// Minimal samples drawn.
    pub hypotheses: u32,
    /// Milliseconds of each stage.
    pub times: AnswerTimes,
}

/// A camera's pose in the map, and its uncertainty; of a rig, the rig's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnswerPose {
    /// Hamilton unit quaternion `w x y z`: map coordinates to camera coordinates.
    pub rotation: [f64; 4],
    /// `t` of `x_camera = R x_map + t`, map units.
    pub translation: [f64; 3],
    /// Covariance, rows and columns, of a rotation vector `w` about the camera's axes (radians), then a vector `v`
    /// along them (map units): the pose is `R' = exp(w) R`, `t' = exp(w) t + v` (the left tangent). Infinite on the
    /// diagonal where the matches leave a direction free. Relative to the map: how well the map is placed on earth is
    /// not part of it.
    pub covariance: [[f64; 6]; 6],
}

impl AnswerPose {
    /// The rigid transform; `None` when the quaternion is zero or a number is not finite, as in no decoded answer.
    pub fn cam_from_world(&self) -> Option<CameraFromWorld> {
        CameraFromWorld::from_quaternion(self.rotation, self.translation)
    }

    /// Where the camera is in the map, map units: `−Rᵀ t`. NaN where [`Self::cam_from_world`] is `None`.
    pub fn center(&self) -> [f64; 3] {
        self.cam_from_world().map_or([f64::NAN; 3], |pose| pose.center().coords.into())
    }

    /// Covariance of [`Self::center`] in the map's axes, map units squared. NaN as there.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.cam_from_world().map_or([[f64::NAN; 3]; 3], |pose| pose.center_covariance(&self.covariance))
    }

    /// The ± of the position: standard deviation of the centre in its least certain direction, map units; infinite
    /// where the matches leave a direction free.
    pub fn position_sd(&self) -> f64 {
        position_sd(&self.covariance)
    }

    /// The ± of the orientation about its least certain axis, degrees; infinite as above.
    pub fn rotation_sd_deg(&self) -> f64 {
        rotation_sd_degrees(&self.covariance)
    }
}

/// What the coordinates of a map mean.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapCoordinates {
    /// Metres of a unit of the map; `None` when the unit is not known.
    pub metres_per_unit: Option<f64>,
    /// Unit vector along gravity; `None` when the map does not know it.
    pub down: Option<[f64; 3]>,
}

/// Use of the gravity direction of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum GravityUse {
    /// The query has no gravity direction.
    #[default]
    NotProvided,
    /// It was used.
    Used,
    /// The query has one, but the map has none: it was not used.
    UnknownInMap,
}

impl GravityUse {
    /// All of them; the index of each is its code.
    pub const ALL: [Self; 3] = [Self::NotProvided, Self::Used, Self::UnknownInMap];

    /// The name in JSON; `None` when the query has no gravity direction.
    pub const fn name(self) -> Option<&'static str> {
        match self {
            Self::NotProvided => None,
            Self::Used => Some("used"),
            Self::UnknownInMap => Some("unused"),
        }
    }

    pub(crate) const fn code(self) -> u32 {
        match self {
            Self::NotProvided => 0,
            Self::Used => 1,
            Self::UnknownInMap => 2,
        }
    }
}

/// How well a query fits its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnswerFit {
    /// Standard deviation of the residuals of the agreeing rows, pixels of the query's camera.
    pub noise_px: f64,
    /// Estimated focal length divided by that of the query; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Estimated principal point minus that of the query, pixels of the query's camera; 0 when it was not estimated.
    pub principal_shift_px: [f64; 2],
}

impl Answer {
    /// The length of an encoded answer is a multiple of this. Answers without doubts, with every kind of doubt, and
    /// without a pose all have this length.
    pub const PADDED_BYTES: usize = 4096;

    /// Trusted or doubtful.
    pub const fn state(&self) -> AnswerState {
        if self.trusted() { AnswerState::Trusted } else { AnswerState::Doubtful }
    }

    /// Whether there are no doubts about the pose. A pose that is not trusted should not be shown to a user.
    pub const fn trusted(&self) -> bool {
        self.doubts.is_empty()
    }

    /// [`AnswerPose::position_sd`]; infinite without a pose.
    pub fn position_sd(&self) -> f64 {
        self.pose.as_ref().map_or(f64::INFINITY, AnswerPose::position_sd)
    }

    /// As JSON: [`AnswerDocument`](crate::AnswerDocument).
    pub fn to_json(&self) -> String {
        // Only a map with keys that are no text, or a failing writer, cannot be written.
        serde_json::to_string(&crate::AnswerDocument::new(self)).unwrap_or_default()
    }

    /// The answer without its pose when that is doubtful, for clients that request trusted poses only.
    #[must_use]
    pub fn trusted_only(mut self) -> Self {
        self.pose = self.pose.filter(|_| self.doubts.is_empty());
        self
    }
}

/// Milliseconds the server spent.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnswerTimes {
    /// Waiting for a worker.
    #[serde(rename = "queue")]
    pub queue_ms: f64,
    /// Finding similar map images.
    #[serde(rename = "retrieve")]
    pub retrieve_ms: f64,
    /// Matching descriptors.
    #[serde(rename = "match")]
    pub match_ms: f64,
    /// Estimating the pose.
    #[serde(rename = "pose")]
    pub pose_ms: f64,
}

/// One reason not to trust a pose.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnswerDoubt {
    /// For programs.
    pub kind: DoubtKind,
    /// For people.
    pub text: String,
}

/// What a doubt is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DoubtKind {
    /// None of the other kinds.
    Other,
    /// The number of agreeing matches could be chance.
    WeakEvidence,
    /// Another pose explains the matches nearly as well.
    Ambiguous,
    /// The agreeing matches leave a direction nearly free.
    Imprecise,
    /// Nearly all agreeing lines belong to one anchor.
    OneSided,
}

impl DoubtKind {
    /// All of them; the index of each is its code.
    pub const ALL: [Self; 5] =
        [Self::Other, Self::WeakEvidence, Self::Ambiguous, Self::Imprecise, Self::OneSided];

    /// The name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Other => "other",
            Self::WeakEvidence => "weak-evidence",
            Self::Ambiguous => "ambiguous",
            Self::Imprecise => "imprecise",
            Self::OneSided => "one-sided",
        }
    }

    pub(crate) const fn code(self) -> u32 {
        match self {
            Self::Other => 0,
            Self::WeakEvidence => 1,
            Self::Ambiguous => 2,
            Self::Imprecise => 3,
            Self::OneSided => 4,
        }
    }
}
