//! How long workers take of late, and so when to ask a second one; and how many second messages there may be.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Times that are remembered.
const REMEMBERED: usize = 128;
/// Before anything is known.
pub(super) const UNKNOWN: Duration = Duration::from_secs(2);
/// A second message is never sent sooner, nor later.
pub(super) const SOONEST: Duration = Duration::from_millis(20);
pub(super) const LATEST: Duration = Duration::from_secs(10);

/// Second messages that may be sent without first ones between them, and what a first one adds. With 64 in the place of 8, 70
/// second messages went out for 109 queries on a busy machine (scripts/cluster_chaos.py).
const MOST_SPARE: f64 = 8.0;
const EARNED: f64 = 0.1;

/// The pace of one kind of work.
#[derive(Debug, Default)]
pub(crate) struct Pace(Mutex<Known>);

#[derive(Debug)]
struct Known {
    /// The last times, in no order.
    times: Vec<Duration>,
    next: usize,
    spare: f64,
}

impl Default for Known {
    fn default() -> Self {
        Self { times: Vec::new(), next: 0, spare: MOST_SPARE }
    }
}

impl Pace {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A worker took so long.
    pub(crate) fn took(&self, time: Duration) {
        let mut known = self.known();
        let place = known.next;
        if known.times.len() < REMEMBERED {
            known.times.push(time);
        } else {
            known.times[place] = time;
        }
        known.next = (place + 1) % REMEMBERED;
    }

    /// When to ask a second worker: half as long again as nineteen of twenty take.
    pub(crate) fn second_after(&self) -> Duration {
        let mut times = self.known().times.clone();
        if times.is_empty() {
            return UNKNOWN;
        }
        let rank = (times.len() * 19 / 20).min(times.len() - 1);
        let (_, slow, _) = times.select_nth_unstable(rank);
        (*slow * 3 / 2).clamp(SOONEST, LATEST)
    }

    /// A first message is sent.
    pub(crate) fn first(&self) {
        let mut known = self.known();
        known.spare = (known.spare + EARNED).min(MOST_SPARE);
    }

    /// Whether a second one may be: one for ten first ones in the long run, so that workers who are slow because there is
    /// much to do do not get twice as much.
    pub(crate) fn may_send_second(&self) -> bool {
        let mut known = self.known();
        let may = known.spare >= 1.0;
        if may {
            known.spare -= 1.0;
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_worker_is_asked_when_nearly_all_would_have_answered() {
        let pace = Pace::default();
        assert_eq!(pace.second_after(), UNKNOWN);
        for ms in (1..=100).rev() {
            pace.took(Duration::from_millis(ms));
        }
        assert_eq!(pace.second_after(), Duration::from_millis(96 * 3 / 2));
        for _ in 0..REMEMBERED {
            pace.took(Duration::from_micros(10));
        }
        assert_eq!(pace.second_after(), SOONEST, "old times are forgotten");
        for _ in 0..REMEMBERED {
            pace.took(Duration::from_secs(20));
        }
        assert_eq!(pace.second_after(), LATEST);
    }

    #[test]
    fn second_messages_are_a_tenth_in_the_long_run() {
        let pace = Pace::default();
        let burst = (0..1000).filter(|_| pace.may_send_second()).count();
        assert_eq!(burst, 8);
        let more = (0..1000)
            .filter(|_| {
                pace.first();
                pace.may_send_second()
            })
            .count();
        assert!((98..=100).contains(&more), "{more}");
    }
}
