//! Decides when to read a file again: a version that was read is not read again, a version that failed is retried
//! with growing pauses.

use std::time::{Duration, Instant};

/// Pause after the first failure; it doubles with every further one.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// Longest pause.
const MAX_PAUSE: Duration = Duration::from_secs(60);

/// The versions of a file that were tried. A version counts as read only if it was read completely.
#[derive(Debug)]
pub struct ReloadAttempts<S> {
    taken: Option<S>,
    failed: Option<Failed<S>>,
}

#[derive(Debug)]
struct Failed<S> {
    state: S,
    times: u32,
    again: Instant,
}

impl<S> Default for ReloadAttempts<S> {
    fn default() -> Self {
        Self { taken: None, failed: None }
    }
}

impl<S: PartialEq> ReloadAttempts<S> {
    /// Whether a file in this version must be read now.
    pub fn is_due(&self, state: &S, now: Instant) -> bool {
        match &self.failed {
            // The same version failed before. Memory or open files may have been missing, so it is retried.
            Some(failed) if failed.state == *state => now >= failed.again,
            Some(_) => true,
            None => self.taken.as_ref() != Some(state),
        }
    }

    /// The file was read completely in this version.
    pub fn succeeded(&mut self, state: S) {
        self.taken = Some(state);
        self.failed = None;
    }

    /// The file could not be read or used.
    pub fn failed(&mut self, state: S, now: Instant) {
        let times = match &self.failed {
            Some(before) if before.state == state => before.times.saturating_add(1),
            _ => 1,
        };
        let pause = FIRST_PAUSE.saturating_mul(1 << (times - 1).min(16)).min(MAX_PAUSE);
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
    fn failures_are_retried_with_backoff() {
        let mut attempts = ReloadAttempts::default();
        let mut now = Instant::now();
        assert!(attempts.is_due(&1, now));
        attempts.succeeded(1);
        assert!(!attempts.is_due(&1, now) && attempts.is_due(&2, now));
        for pause in [1, 2, 4, 8, 16, 32, 60, 60] {
            attempts.failed(2, now);
            assert!(attempts.is_failing());
            assert!(!attempts.is_due(&2, now + Duration::from_millis(1000 * pause - 1)));
            now += Duration::from_secs(pause);
            assert!(attempts.is_due(&2, now), "after {pause} s");
            assert!(attempts.is_due(&3, now) && attempts.is_due(&1, now), "another version is read at once");
        }
        attempts.failed(3, now);
        assert!(
            attempts.is_due(&3, now + FIRST_PAUSE),
            "a failure of another version starts with the first pause"
        );
        attempts.succeeded(3);
        assert!(!attempts.is_failing() && !attempts.is_due(&3, now));
    }
}
