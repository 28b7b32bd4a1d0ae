//! Recent latencies of workers, which give the delay of hedged requests, and the budget of hedged requests.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Number of stored latencies.
const WINDOW: usize = 128;
/// Delay before the first measurement.
pub(super) const INITIAL_DELAY: Duration = Duration::from_secs(2);
/// Bounds of the delay.
pub(super) const MIN_DELAY: Duration = Duration::from_millis(20);
pub(super) const MAX_DELAY: Duration = Duration::from_secs(10);

/// Maximum hedge budget, and what a request adds to it. With 64 in place of 8, 70 hedges were sent for 109 queries on
/// a busy machine (scripts/cluster_chaos.py).
const MAX_BUDGET: f64 = 8.0;
const BUDGET_PER_REQUEST: f64 = 0.1;

/// The latency of one kind of work.
#[derive(Debug, Default)]
pub(crate) struct LatencyTracker(Mutex<Window>);

#[derive(Debug)]
struct Window {
    /// The last latencies, unsorted.
    times: Vec<Duration>,
    next: usize,
    budget: f64,
}

impl Default for Window {
    fn default() -> Self {
        Self { times: Vec::new(), next: 0, budget: MAX_BUDGET }
    }
}

impl LatencyTracker {
    fn window(&self) -> MutexGuard<'_, Window> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records the latency of a reply.
    pub(crate) fn record(&self, time: Duration) {
        let mut window = self.window();
        let place = window.next;
        if window.times.len() < WINDOW {
            window.times.push(time);
        } else {
            window.times[place] = time;
        }
        window.next = (place + 1) % WINDOW;
    }

    /// Delay after which a request is hedged: 1.5 times the 95th percentile.
    pub(crate) fn hedge_after(&self) -> Duration {
        let mut times = self.window().times.clone();
        if times.is_empty() {
            return INITIAL_DELAY;
        }
        let rank = (times.len() * 19 / 20).min(times.len() - 1);
        let (_, slow, _) = times.select_nth_unstable(rank);
        (*slow * 3 / 2).clamp(MIN_DELAY, MAX_DELAY)
    }

    /// Records a request, which adds to the budget.
    pub(crate) fn record_request(&self) {
        let mut window = self.window();
        window.budget = (window.budget + BUDGET_PER_REQUEST).min(MAX_BUDGET);
    }

    /// Takes one hedge from the budget, if available. In the long run one request in ten may be hedged, so that an
    /// overloaded cluster does not get twice the load.
    pub(crate) fn take_hedge(&self) -> bool {
        let mut window = self.window();
        let may = window.budget >= 1.0;
        if may {
            window.budget -= 1.0;
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hedge_delay_is_above_most_latencies() {
        let latency = LatencyTracker::default();
        assert_eq!(latency.hedge_after(), INITIAL_DELAY);
        for ms in (1..=100).rev() {
            latency.record(Duration::from_millis(ms));
        }
        assert_eq!(latency.hedge_after(), Duration::from_millis(96 * 3 / 2));
        for _ in 0..WINDOW {
            latency.record(Duration::from_micros(10));
        }
        assert_eq!(latency.hedge_after(), MIN_DELAY, "old times are forgotten");
        for _ in 0..WINDOW {
            latency.record(Duration::from_secs(20));
        }
        assert_eq!(latency.hedge_after(), MAX_DELAY);
    }

    #[test]
    fn hedges_are_limited_to_a_tenth() {
        let latency = LatencyTracker::default();
        let burst = (0..1000).filter(|_| latency.take_hedge()).count();
        assert_eq!(burst, 8);
        let more = (0..1000)
            .filter(|_| {
                latency.record_request();
                latency.take_hedge()
            })
            .count();
        assert!((98..=100).contains(&more), "{more}");
    }
}
