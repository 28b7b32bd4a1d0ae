//! Images without a pose, and why.

use std::fmt;

/// An image without a pose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unregistered {
    /// Its name.
    pub name: String,
    /// The likely cause.
    pub cause: UnregisteredCause,
}

impl fmt::Display for Unregistered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: no pose: {}", self.name, self.cause)
    }
}

/// Why an image has no pose, as far as known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnregisteredCause {
    /// It has few keypoints.
    FewKeypoints(usize),
    /// No other image has verified matches with it.
    NoMatches,
    /// Some images match it, but too few for a pose.
    FewMatches {
        /// Number of images.
        images: usize,
    },
    /// It is in another model.
    OtherModel,
    /// The program does not say.
    Unknown,
}

impl fmt::Display for UnregisteredCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewKeypoints(n) => write!(f, "{n} keypoints: blurred, dark or without texture"),
            Self::NoMatches => f.write_str("no other image matches it"),
            Self::FewMatches { images } => {
                write!(f, "{images} images match it, too few or without parallax")
            }
            Self::OtherModel => f.write_str("in another model, not connected to this one"),
            Self::Unknown => f.write_str("cause unknown"),
        }
    }
}
