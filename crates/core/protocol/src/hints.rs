//! What a device may say beside its rows: how well its focal length is known, and which way is down.

use std::fmt;
use std::str::FromStr;

use crate::{CoarseGravity, QueryError};

/// What a device says of its camera beside the rows. The default says that it is calibrated, and nothing of gravity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hints {
    /// How well the focal length is known.
    pub focal: FocalKnowledge,
    /// Which way is down in the camera, roughly.
    pub gravity: Option<CoarseGravity>,
}

/// How well the focal length of the camera is known that the rows are told in.
///
/// One of three words, and no number: the focal length itself stays on the ladder of
/// [`CanonicalCamera`](crate::CanonicalCamera).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FocalKnowledge {
    /// Measured for this camera.
    #[default]
    Calibrated,
    /// Told by the image's metadata: mostly right to some per cent, wrong when the image was cropped.
    Exif,
    /// A guess.
    Unknown,
}

impl FocalKnowledge {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Calibrated, Self::Exif, Self::Unknown];

    /// As people write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Calibrated => "calibrated",
            Self::Exif => "exif",
            Self::Unknown => "unknown",
        }
    }

    pub(crate) const fn code(self) -> u32 {
        match self {
            Self::Calibrated => 1,
            Self::Exif => 2,
            Self::Unknown => 3,
        }
    }

    pub(crate) fn from_code(code: u32) -> Result<Self, QueryError> {
        Self::ALL.into_iter().find(|known| known.code() == code).ok_or(QueryError::Field {
            field: "focal_known",
            value: code,
            allowed: "1 (calibrated), 2 (from EXIF) or 3 (unknown)",
        })
    }
}

impl fmt::Display for FocalKnowledge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A text named no knowledge of a focal length.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not calibrated, exif or unknown")]
pub struct UnknownKnowledge {
    /// The text as given.
    pub text: String,
}

impl FromStr for FocalKnowledge {
    type Err = UnknownKnowledge;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|known| known.name() == text);
        known.ok_or_else(|| UnknownKnowledge { text: text.to_owned() })
    }
}
