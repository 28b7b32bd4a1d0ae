//! Limits the log lines that unauthenticated clients can cause, so that they cannot fill a disk.
//!
//! The first few lines of each kind per minute are written; the others are counted, and one line per minute reports
//! the count. A kind is a status and the name of a problem, so their number is bounded.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Lines of one kind per interval: 10 per minute are about 2 MB a day.
const LINES: u64 = 10;

/// Status, and name of the problem.
pub type LogKind = (u16, &'static str);

/// Lines of each kind since the last report.
#[derive(Debug, Default)]
pub struct LogThrottle(Mutex<BTreeMap<LogKind, u64>>);

impl LogThrottle {
    /// Whether to write a line of this kind; suppressed lines are counted.
    pub fn should_log(&self, kind: LogKind) -> bool {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let lines = counts.entry(kind).or_default();
        *lines += 1;
        *lines <= LINES
    }

    /// Numbers of suppressed lines since the last call; resets the counts.
    pub fn take_suppressed(&self) -> Vec<(LogKind, u64)> {
        let counts = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        counts
            .into_iter()
            .filter(|(_, lines)| *lines > LINES)
            .map(|(kind, lines)| (kind, lines - LINES))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_lines_are_written_and_the_rest_counted() {
        let throttle = LogThrottle::default();
        let (a, b) = ((401, "unauthenticated"), (404, "not-found"));
        assert_eq!((0..100_000).filter(|_| throttle.should_log(a)).count() as u64, LINES);
        assert!(throttle.should_log(b), "another kind has its own limit");
        assert_eq!(throttle.take_suppressed(), [(a, 100_000 - LINES)]);
        assert!(throttle.take_suppressed().is_empty() && throttle.should_log(a), "the counts were reset");
    }
}
