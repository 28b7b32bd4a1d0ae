//! Log lines that clients without a token can cause are summed up, so that nobody without a token can fill a disk with them.
//!
//! Of each kind the first few in a minute are written; the others are counted, and one line a minute tells how many.
//! Kinds are statuses with the name of a problem, so there are few of them.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Lines of one kind that are written between two sums: 10 a minute are some 2 MB a day.
const LINES: u64 = 10;

/// Status and problem.
pub type Kind = (u16, &'static str);

/// What was asked to be logged since the last sum.
#[derive(Debug, Default)]
pub struct Throttle(Mutex<BTreeMap<Kind, u64>>);

impl Throttle {
    /// Whether a line of this kind is to be written; one that is not is counted.
    pub fn admits(&self, kind: Kind) -> bool {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = counts.entry(kind).or_default();
        *asked += 1;
        *asked <= LINES
    }

    /// How many lines of each kind were left out since the last sum; begins anew.
    pub fn sum(&self) -> Vec<(Kind, u64)> {
        let counts = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        counts
            .into_iter()
            .filter(|(_, asked)| *asked > LINES)
            .map(|(kind, asked)| (kind, asked - LINES))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_are_written_and_the_rest_are_summed() {
        let throttle = Throttle::default();
        let (a, b) = ((401, "unauthenticated"), (404, "not-found"));
        assert_eq!((0..100_000).filter(|_| throttle.admits(a)).count() as u64, LINES);
        assert!(throttle.admits(b), "another kind has its own lines");
        assert_eq!(throttle.sum(), [(a, 100_000 - LINES)]);
        assert!(throttle.sum().is_empty() && throttle.admits(a), "begins anew");
    }
}
