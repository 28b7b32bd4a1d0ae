//! Number of minimal samples of a search: fixed for comparisons at equal effort, or adaptive.

use std::fmt;
use std::str::FromStr;

/// Number of hypotheses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hypotheses {
    /// Adaptive: until a better hypothesis is unlikely.
    Adaptive,
    /// Exactly this many.
    Fixed(usize),
}

/// Upper limit: more would take hours per query.
const MAX_HYPOTHESES: usize = 10_000_000;

/// A text that is neither `adaptive` nor an allowed number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a number of hypotheses; write a whole number from 1 to {MAX_HYPOTHESES}, or adaptive")]
pub struct HypothesesError(String);

impl Hypotheses {
    /// The number, if it is fixed.
    pub const fn fixed(self) -> Option<usize> {
        match self {
            Self::Adaptive => None,
            Self::Fixed(count) => Some(count),
        }
    }
}

impl From<Option<usize>> for Hypotheses {
    fn from(fixed: Option<usize>) -> Self {
        fixed.map_or(Self::Adaptive, Self::Fixed)
    }
}

impl FromStr for Hypotheses {
    type Err = HypothesesError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.trim() {
            "adaptive" => Ok(Self::Adaptive),
            number => match number.parse() {
                Ok(count) if (1..=MAX_HYPOTHESES).contains(&count) => Ok(Self::Fixed(count)),
                _ => Err(HypothesesError(text.to_owned())),
            },
        }
    }
}

impl fmt::Display for Hypotheses {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Adaptive => f.pad("adaptive"),
            Self::Fixed(count) => count.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Hypotheses;

    #[test]
    fn hypotheses_round_trip() {
        for text in ["adaptive", "1", "5000"] {
            assert_eq!(text.parse::<Hypotheses>().expect("well written").to_string(), text);
        }
        for text in ["", "0", "-1", "1.5", "many", "10000001"] {
            assert!(text.parse::<Hypotheses>().is_err(), "{text:?}");
        }
    }
}
