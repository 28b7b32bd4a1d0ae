//! Which regions of a map a worker holds.

use std::collections::BTreeSet;
use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use crate::ClusterError;

/// A share of the regions of a map. The workers of a cluster must together hold all regions; shares may overlap.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum RegionShare {
    /// All.
    #[default]
    All,
    /// Every `of`-th region, beginning with number `nth` (from 0). Neighbouring regions belong to different workers,
    /// so a popular area is the work of several.
    Nth {
        /// Offset, below `of`.
        nth: usize,
        /// Number of shares.
        of: NonZeroUsize,
    },
    /// The regions with these numbers in the manifest; unknown numbers are ignored.
    Numbers(BTreeSet<usize>),
}

impl RegionShare {
    /// Whether the share contains this region.
    pub fn contains(&self, region: usize) -> bool {
        match self {
            Self::All => true,
            Self::Nth { nth, of } => region % of.get() == *nth,
            Self::Numbers(numbers) => numbers.contains(&region),
        }
    }
}

/// `all`, `1/3` (the first of three), or `0,4,7`.
impl FromStr for RegionShare {
    type Err = ClusterError;

    fn from_str(text: &str) -> Result<Self, ClusterError> {
        let wrong = || ClusterError::Share { text: text.to_owned() };
        if text == "all" {
            return Ok(Self::All);
        }
        if let Some((nth, of)) = text.split_once('/') {
            let of: NonZeroUsize = of.trim().parse().map_err(|_| wrong())?;
            let nth: NonZeroUsize = nth.trim().parse().map_err(|_| wrong())?;
            return if nth <= of { Ok(Self::Nth { nth: nth.get() - 1, of }) } else { Err(wrong()) };
        }
        let numbers: Result<BTreeSet<usize>, _> = text.split(',').map(|word| word.trim().parse()).collect();
        numbers.map(Self::Numbers).map_err(|_| wrong())
    }
}

impl fmt::Display for RegionShare {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Nth { nth, of } => write!(f, "{}/{of}", nth + 1),
            Self::Numbers(numbers) => {
                let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
                f.write_str(&words.join(","))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_round_trip_and_cover_all_regions() {
        for text in ["all", "1/1", "2/3", "0,4,7"] {
            assert_eq!(text.parse::<RegionShare>().expect("a share").to_string(), text);
        }
        for bad in ["", "0/3", "4/3", "1/0", "a", "1,", "-1", "1/2/3"] {
            assert!(matches!(bad.parse::<RegionShare>(), Err(ClusterError::Share { .. })), "{bad:?}");
        }
        let thirds: Vec<RegionShare> =
            ["1/3", "2/3", "3/3"].map(|text| text.parse().expect("a share")).into();
        for region in 0..10 {
            assert_eq!(thirds.iter().filter(|share| share.contains(region)).count(), 1, "region {region}");
        }
        let some: RegionShare = "1, 4".parse().expect("a share");
        assert_eq!((0..6).filter(|region| some.contains(*region)).collect::<Vec<_>>(), [1, 4]);
    }
}
