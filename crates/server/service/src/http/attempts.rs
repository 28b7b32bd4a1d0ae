//! When to read a file again: what was read once is not read again, what could not be read is, ever more seldom.

use std::time::{Duration, Instant};

/// Pause after the first failure; it doubles with every further one.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// Longest pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// What is known of the states a file was in. A state counts as read only when all of it was.
#[derive(Debug)]
pub struct Attempts<S> {
    taken: Option<S>,
    failed: Option<Failed<S>>,
}

#[derive(Debug)]
struct Failed<S> {
    state: S,
    times: u32,
    again: Instant,
}

impl<S> Default for Attempts<S> {
    fn default() -> Self {
        Self { taken: None, failed: None }
    }
}

impl<S: PartialEq> Attempts<S> {
    /// Whether a file in this state is to be read now.
    pub fn is_due(&self, state: &S, now: Instant) -> bool {
        match &self.failed {
            // The same that failed before: what is missing may be memory or open files, so it is tried again.
            Some(failed) if failed.state == *state => now >= failed.again,
            Some(_) => true,
            None => self.taken.as_ref() != Some(state),
        }
    }

    /// It was read in this state from its beginning to its end.
    pub fn took(&mut self, state: S) {
        self.taken = Some(state);
        self.failed = None;
    }

    /// It could not be read, or not be used.
    pub fn failed(&mut self, state: S, now: Instant) {
        let times = match &self.failed {
            Some(before) if before.state == state => before.times.saturating_add(1),
            _ => 1,
        };
        let pause = FIRST_PAUSE.saturating_mul(1 << (times - 1).min(16)).min(LONGEST_PAUSE);
        self.failed = Some(Failed { state, times, again: now + pause });
    }

    /// Whether the last attempt failed.
    pub const fn is_failing(&self) -> bool {
        self.failed.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_are_tried_again_ever_more_seldom_and_successes_are_not() {
        let mut attempts = Attempts::default();
        let mut now = Instant::now();
        assert!(attempts.is_due(&1, now));
        attempts.took(1);
        assert!(!attempts.is_due(&1, now) && attempts.is_due(&2, now));
        for pause in [1, 2, 4, 8, 16, 32, 60, 60] {
            attempts.failed(2, now);
            assert!(attempts.is_failing());
            assert!(!attempts.is_due(&2, now + Duration::from_millis(1000 * pause - 1)));
            now += Duration::from_secs(pause);
            assert!(attempts.is_due(&2, now), "after {pause} s");
            assert!(
                attempts.is_due(&3, now) && attempts.is_due(&1, now),
                "another state is looked at at once"
            );
        }
        attempts.failed(3, now);
        assert!(attempts.is_due(&3, now + FIRST_PAUSE), "another failure starts anew");
        attempts.took(3);
        assert!(!attempts.is_failing() && !attempts.is_due(&3, now));
    }
}
