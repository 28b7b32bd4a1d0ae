//! What queries are put under.

use std::fmt;
use std::str::FromStr;

/// A way in which localization is made harder.
///
/// | name | what is done |
/// |---|---|
/// | `none` | nothing |
/// | `dark` | an eighth of the light, with the noise of few photons |
/// | `motion` | the camera moves by 13 px of 640 during the exposure |
/// | `half-hidden` | a flat gray thing covers one half of the image |
/// | `low-resolution` | the image has 160 pixels along its longer side, and is enlarged |
/// | `sparse-map` | the map is of every tenth image |
/// | `few-keypoints` | the device sends the smallest size class, 256 rows |
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stress {
    /// Images as they are.
    None,
    /// Little light.
    Dark,
    /// Motion blur.
    Motion,
    /// One half covered.
    HalfHidden,
    /// Few pixels.
    LowResolution,
    /// Few images in the map.
    SparseMap,
    /// Few rows in the query.
    FewKeypoints,
}

/// A text names no stress.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no stress; there are none, dark, motion, half-hidden, low-resolution, sparse-map and few-keypoints"
)]
pub struct StressError(String);

impl Stress {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 7] = [
        Self::None,
        Self::Dark,
        Self::Motion,
        Self::HalfHidden,
        Self::LowResolution,
        Self::SparseMap,
        Self::FewKeypoints,
    ];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Dark => "dark",
            Self::Motion => "motion",
            Self::HalfHidden => "half-hidden",
            Self::LowResolution => "low-resolution",
            Self::SparseMap => "sparse-map",
            Self::FewKeypoints => "few-keypoints",
        }
    }
}

impl FromStr for Stress {
    type Err = StressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|stress| stress.name() == text.trim());
        known.ok_or_else(|| StressError(text.to_owned()))
    }
}

impl fmt::Display for Stress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_what_they_print() {
        for stress in Stress::ALL {
            assert_eq!(stress.to_string().parse(), Ok(stress));
        }
        assert!("light".parse::<Stress>().is_err());
    }
}
