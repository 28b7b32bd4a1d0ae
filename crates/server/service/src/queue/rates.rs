//! Rate limits of tokens.

use std::num::{NonZeroU32, NonZeroU64};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::options::RateLimit;
use crate::queue::clock::Clock;

/// How the limits of a service are made.
#[derive(Debug, Clone)]
pub(crate) struct RatePolicy {
    pub(crate) rate: RateLimit,
    pub(crate) clock: Clock,
}

impl RatePolicy {
    /// A full bucket.
    pub(crate) fn limit(&self) -> Arc<TokenRateLimit> {
        let full_at = Mutex::new(self.clock.now());
        Arc::new(TokenRateLimit { rate: self.rate, clock: self.clock.clone(), full_at })
    }
}

/// Rate limit of a token. It survives changes of other properties of the token.
pub(crate) struct TokenRateLimit {
    rate: RateLimit,
    clock: Clock,
    /// When the token bucket will be full: it lacks one request for each interval until then.
    full_at: Mutex<Instant>,
}

impl TokenRateLimit {
    /// Burst size.
    pub(crate) const fn burst(&self) -> NonZeroU32 {
        self.rate.burst
    }

    /// Takes these requests, or says how long to wait until they can be taken.
    pub(crate) fn spend(&self, requests: NonZeroU32) -> Result<(), Duration> {
        let now = self.clock.now();
        let mut full_at = self.full_at.lock().unwrap_or_else(PoisonError::into_inner);
        let from = (*full_at).max(now);
        let next = from + self.time_of(requests);
        let latest = now + self.time_of(self.rate.burst);
        if next > latest {
            return Err(next - latest);
        }
        *full_at = next;
        Ok(())
    }

    /// The time in which this many requests are earned.
    fn time_of(&self, requests: NonZeroU32) -> Duration {
        Duration::from_secs(requests.get().into()) / self.rate.per_second.get()
    }
}

/// Whole seconds for `Retry-After`: rounded up, at least one.
pub(crate) fn seconds_up(wait: Duration) -> NonZeroU64 {
    NonZeroU64::new(wait.as_secs() + u64::from(wait.subsec_nanos() > 0)).unwrap_or(NonZeroU64::MIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::clock::ManualClock;

    #[test]
    fn flood_gets_the_rate() {
        let number = |n: u32| NonZeroU32::new(n).expect("not zero");
        let clock = ManualClock::new();
        let rate = RateLimit { per_second: number(5), burst: number(5) };
        let limit = RatePolicy { rate, clock: clock.clock() }.limit();
        assert_eq!((0..10).filter(|_| limit.spend(NonZeroU32::MIN).is_ok()).count(), 5, "the burst");
        assert_eq!(limit.spend(number(2)), Err(Duration::from_millis(400)));
        let accepted = (0..6000).filter(|_| {
            clock.advance(Duration::from_millis(10));
            limit.spend(NonZeroU32::MIN).is_ok()
        });
        assert_eq!(accepted.count(), 300, "in 60 s");
    }

    #[test]
    fn seconds_are_rounded_up() {
        for (ms, seconds) in [(0, 1), (1, 1), (1000, 1), (1001, 2), (59_000, 59)] {
            assert_eq!(seconds_up(Duration::from_millis(ms)).get(), seconds);
        }
    }
}
