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

/// The latency of one kind of work.
#[derive(Debug, Default)]
pub(crate) struct LatencyTracker(Mutex<Known>);

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

impl LatencyTracker {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A worker took so long.
    pub(crate) fn record(&self, time: Duration) {
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
    pub(crate) fn hedge_after(&self) -> Duration {
        let mut times = self.known().times.clone();
        if times.is_empty() {
            return UNKNOWN;
        }
        let rank = (times.len() * 19 / 20).min(times.len() - 1);
        let (_, slow, _) = times.select_nth_unstable(rank);
        (*slow * 3 / 2).clamp(SOONEST, LATEST)
    }

    /// A first message is sent.
    pub(crate) fn record_request(&self) {
        let mut known = self.known();
        known.spare = (known.spare + EARNED).min(MOST_SPARE);
    }

    /// Whether a second one may be: one for ten first ones in the long run, so that workers who are slow because there is
    /// much to do do not get twice as much.
    pub(crate) fn may_hedge(&self) -> bool {
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
        let latency = LatencyTracker::default();
        assert_eq!(latency.hedge_after(), UNKNOWN);
        for ms in (1..=100).rev() {
            latency.record(Duration::from_millis(ms));
        }
        assert_eq!(latency.hedge_after(), Duration::from_millis(96 * 3 / 2));
        for _ in 0..REMEMBERED {
            latency.record(Duration::from_micros(10));
        }
        assert_eq!(latency.hedge_after(), SOONEST, "old times are forgotten");
        for _ in 0..REMEMBERED {
            latency.record(Duration::from_secs(20));
        }
        assert_eq!(latency.hedge_after(), LATEST);
    }

    #[test]
    fn second_messages_are_a_tenth_in_the_long_run() {
        let latency = LatencyTracker::default();
        let burst = (0..1000).filter(|_| latency.may_hedge()).count();
        assert_eq!(burst, 8);
        let more = (0..1000)
            .filter(|_| {
                latency.record_request();
                latency.may_hedge()
            })
            .count();
        assert!((98..=100).contains(&more), "{more}");
    }
}
