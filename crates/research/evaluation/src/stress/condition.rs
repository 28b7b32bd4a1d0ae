//! Conditions of queries.

use std::fmt;
use std::str::FromStr;

/// A condition that makes localization more difficult.
///
/// | name | effect |
/// |---|---|
/// | `none` | nothing |
/// | `dark` | an eighth of the light, with photon noise |
/// | `motion` | the camera moves by 13 px of 640 during the exposure |
/// | `half-hidden` | flat gray covers one half of the image, cut through its centre in a random direction |
/// | `side-hidden` | the same for the left or right half: then all visible keypoints may belong to one anchor of `dcl` |
/// | `low-resolution` | the image is reduced to 160 pixels along its longer side, and enlarged again |
/// | `sparse-map` | the map has every tenth image |
/// | `few-keypoints` | the device sends the smallest size class, 256 rows |
/// | `focal-N` | the assumed focal length is `N` percent (1 to 50) too long or too short, reported as calibrated |
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum StressCondition {
    /// Unmodified images.
    None,
    /// Low light.
    Dark,
    /// Motion blur.
    Motion,
    /// One half covered, cut in a random direction.
    HalfHidden,
    /// The left or the right half covered.
    SideHidden,
    /// Low resolution.
    LowResolution,
    /// A map with few images.
    SparseMap,
    /// A query with few rows.
    FewKeypoints,
    /// A focal length wrong by this percentage, 1 to 50, reported as calibrated.
    Focal(u8),
}

/// A text that is not a stress.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a stress; use one of none, dark, motion, half-hidden, side-hidden, low-resolution, sparse-map, few-keypoints, and focal-N with N from 1 to 50"
)]
pub struct StressError(String);

/// Prefix of [`StressCondition::Focal`] before the percentage.
const FOCAL: &str = "focal-";

/// The largest percentage of [`StressCondition::Focal`].
const MAX_PERCENT: u8 = 50;

impl StressCondition {
    /// The default conditions, in the order of the table.
    pub const DEFAULT: [Self; 8] = [
        Self::None,
        Self::Dark,
        Self::Motion,
        Self::HalfHidden,
        Self::SideHidden,
        Self::LowResolution,
        Self::SparseMap,
        Self::FewKeypoints,
    ];

    /// The name, without the percentage of [`StressCondition::Focal`].
    const fn word(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Dark => "dark",
            Self::Motion => "motion",
            Self::HalfHidden => "half-hidden",
            Self::SideHidden => "side-hidden",
            Self::LowResolution => "low-resolution",
            Self::SparseMap => "sparse-map",
            Self::FewKeypoints => "few-keypoints",
            Self::Focal(_) => FOCAL,
        }
    }
}

impl FromStr for StressCondition {
    type Err = StressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::DEFAULT.into_iter().find(|stress| stress.word() == text.trim());
        let percent = || text.trim().strip_prefix(FOCAL)?.parse().ok();
        let focal = || percent().filter(|p| (1..=MAX_PERCENT).contains(p)).map(Self::Focal);
        known.or_else(focal).ok_or_else(|| StressError(text.to_owned()))
    }
}

impl fmt::Display for StressCondition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Focal(percent) => f.pad(&format!("{FOCAL}{percent}")),
            _ => f.pad(self.word()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stress_names_round_trip() {
        for stress in StressCondition::DEFAULT.into_iter().chain([1, 30, 50].map(StressCondition::Focal)) {
            assert_eq!(stress.to_string().parse(), Ok(stress));
        }
        for no_stress in ["light", "", "focal-", "focal-0", "focal-51", "focal-300", "focal--3", "focal-3.5"]
        {
            assert!(no_stress.parse::<StressCondition>().is_err(), "{no_stress}");
        }
    }
}
