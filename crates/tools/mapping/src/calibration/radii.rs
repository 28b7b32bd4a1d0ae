//! Confidence regions of a normal distribution.

use veiloc_map::LEVELS;

/// Squared radii of the confidence regions of [`LEVELS`] for a normal distribution in three dimensions (quantiles of
/// chi-squared).
pub(crate) const SQUARED_RADII_3: [f64; LEVELS.len()] =
    [2.365_973_884_375_338, 6.251_388_631_170_325, 11.344_866_730_144_373];
/// The same in six dimensions.
pub(crate) const SQUARED_RADII_6: [f64; LEVELS.len()] =
    [5.348_120_627_447_122, 10.644_640_675_668_42, 16.811_893_829_770_927];
