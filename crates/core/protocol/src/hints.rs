//! Optional information about the camera beside the rows: how well its focal length is known, and the gravity
//! direction.

use std::fmt;
use std::str::FromStr;

use crate::{CoarseGravity, QueryError};

/// What a query says about its camera beside the rows. By default the camera is calibrated, and there is no gravity
/// direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hints {
    /// How well the focal length is known.
    pub focal: FocalKnowledge,
    /// The gravity direction in the camera, rounded.
    pub gravity: Option<CoarseGravity>,
}

/// How well the focal length of the camera is known.
///
/// One of three values, not a number: the focal length itself is rounded to the list of
/// [`CanonicalCamera`](crate::CanonicalCamera).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FocalKnowledge {
    /// Measured for this camera.
    #[default]
    Calibrated,
    /// From the image's EXIF data: usually correct to some per cent, wrong when the image was cropped.
    Exif,
    /// A default value.
    Unknown,
}

impl FocalKnowledge {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Calibrated, Self::Exif, Self::Unknown];

    /// The name in text form.
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

/// The text is not a name of [`FocalKnowledge`].
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
