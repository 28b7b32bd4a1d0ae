//! Rate limits of tokens, alone or together with other gateways.
//!
//! Each gateway has the whole bucket of a token, takes from it what it accepts, and reports that to the others, which take it
//! from theirs afterwards ([`SharedRates`]). A bucket that others have emptied goes below zero, and is paid back by
//! waiting. So what arrives late costs a burst once, and the rate over time is that of one gateway (decision 0055).

use std::collections::HashMap;
use std::num::{NonZeroU32, NonZeroU64};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use crate::auth::{Lane, TokenKey};
use crate::options::RateLimit;
use crate::queue::clock::Clock;

/// How the limits of a service are made.
#[derive(Debug, Clone)]
pub(crate) struct RatePolicy {
    pub(crate) rate: RateLimit,
    pub(crate) clock: Clock,
    /// With other gateways.
    pub(crate) shared: Option<SharedRates>,
}

impl RatePolicy {
    /// A full bucket for this token.
    pub(crate) fn limit(&self, key: &TokenKey) -> Arc<TokenRateLimit> {
        let bucket = Mutex::new(Bucket { full_at: self.clock.now() });
        let (rate, clock, lane) = (self.rate, self.clock.clone(), Lane::of(key));
        let limit = Arc::new(TokenRateLimit { rate, clock, bucket, lane, shared: self.shared.clone() });
        if let Some(shared) = &self.shared {
            shared.state().limits.insert(lane, Arc::downgrade(&limit));
        }
        limit
    }
}

/// Rate limit of a token. It survives changes of other properties of the token.
pub(crate) struct TokenRateLimit {
    rate: RateLimit,
    clock: Clock,
    bucket: Mutex<Bucket>,
    lane: Lane,
    shared: Option<SharedRates>,
}

/// A token bucket, as the time at which it will be full: it lacks one request for each interval until then.
struct Bucket {
    full_at: Instant,
}

impl TokenRateLimit {
    /// Burst size.
    pub(crate) const fn burst(&self) -> NonZeroU32 {
        self.rate.burst
    }

    /// Takes these requests, or says how long to wait until they can be taken.
    pub(crate) fn spend(&self, requests: NonZeroU32) -> Result<(), Duration> {
        let weight = self.shared.as_ref().map_or(NonZeroU32::MIN, SharedRates::weight);
        let now = self.clock.now();
        let mut bucket = self.bucket();
        let from = bucket.full_at.max(now);
        let full_at = from + self.time_of(requests.saturating_mul(weight));
        // What is more than the bucket holds is taken from a full one.
        let latest = now + self.time_of(self.rate.burst);
        if full_at > latest && from > now {
            return Err((full_at - latest).min(from - now));
        }
        bucket.full_at = full_at;
        drop(bucket);
        if let Some(shared) = &self.shared {
            shared.spent(self.lane, requests);
        }
        Ok(())
    }

    /// Takes requests that other gateways accepted. The bucket lacks at most the bursts of all gateways then: more cannot
    /// have been accepted at once, and an invalid report must not close a token for long.
    fn charge(&self, requests: NonZeroU32, gateways: NonZeroU32) {
        let now = self.clock.now();
        let mut bucket = self.bucket();
        let full_at = bucket.full_at.max(now) + self.time_of(requests);
        let latest = now + self.time_of(self.rate.burst.saturating_mul(gateways));
        bucket.full_at = full_at.min(latest.max(bucket.full_at));
    }

    fn bucket(&self) -> MutexGuard<'_, Bucket> {
        self.bucket.lock().unwrap_or_else(PoisonError::into_inner)
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

/// What the clients of a service spend, for and from other gateways; clones share it. The messages between gateways are
/// the matter of who uses it (`veiloc-cluster`).
#[derive(Clone, Default)]
pub struct SharedRates(Arc<Inner>);

#[derive(Default)]
struct Inner {
    state: Mutex<State>,
    changed: Notify,
}

struct State {
    limits: HashMap<Lane, Weak<TokenRateLimit>>,
    /// Accepted here and not reported yet.
    spent: HashMap<Lane, u32>,
    gateways: NonZeroU32,
    weight: NonZeroU32,
    stopping: bool,
}

impl Default for State {
    fn default() -> Self {
        let (limits, spent) = (HashMap::new(), HashMap::new());
        Self { limits, spent, gateways: NonZeroU32::MIN, weight: NonZeroU32::MIN, stopping: false }
    }
}

impl SharedRates {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn spent(&self, lane: Lane, requests: NonZeroU32) {
        let mut state = self.state();
        let spent = state.spent.entry(lane).or_default();
        *spent = spent.saturating_add(requests.get());
        drop(state);
        self.0.changed.notify_one();
    }

    fn weight(&self) -> NonZeroU32 {
        self.state().weight
    }

    /// The service was asked to stop.
    pub(crate) fn stop(&self) {
        self.state().stopping = true;
        self.0.changed.notify_one();
    }

    /// Returns when a client spent something, or the service was asked to stop, since the last call.
    pub async fn changed(&self) {
        self.0.changed.notified().await;
    }

    /// Whether the service was asked to stop.
    pub fn is_stopping(&self) -> bool {
        self.state().stopping
    }

    /// The requests of each client that were accepted here since the last call, in the order of the lanes.
    pub fn take_spent(&self) -> Vec<(Lane, NonZeroU32)> {
        let spent = std::mem::take(&mut self.state().spent);
        let known = spent.into_iter().filter_map(|(lane, requests)| Some((lane, NonZeroU32::new(requests)?)));
        let mut all: Vec<_> = known.collect();
        all.sort_unstable();
        all
    }

    /// Another gateway accepted these requests of a client. Clients that are not in the file of tokens are ignored.
    pub fn charge(&self, lane: Lane, requests: NonZeroU32) {
        let mut state = self.state();
        let gateways = state.gateways;
        match state.limits.get(&lane).map(Weak::upgrade) {
            Some(Some(limit)) => {
                drop(state);
                limit.charge(requests, gateways);
            }
            // It was removed from the file.
            Some(None) => {
                state.limits.remove(&lane);
            }
            None => {}
        }
    }

    /// Sets the number of gateways, this one included, and how often a request counts: once, and once more for each
    /// gateway of which nothing is known and that is taken to accept as much as this one.
    pub fn set_gateways(&self, gateways: NonZeroU32, weight: NonZeroU32) {
        let mut state = self.state();
        (state.gateways, state.weight) = (gateways, weight);
    }
}

impl std::fmt::Debug for SharedRates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedRates").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::clock::ManualClock;

    const fn number(n: u32) -> NonZeroU32 {
        NonZeroU32::new(n).expect("not zero")
    }

    const KEY: TokenKey = TokenKey::of_digest([7; 32]);

    struct Gateway {
        shared: SharedRates,
        limit: Arc<TokenRateLimit>,
    }

    fn gateway(clock: &ManualClock, gateways: u32) -> Gateway {
        let shared = SharedRates::default();
        shared.set_gateways(number(gateways), NonZeroU32::MIN);
        let rate = RateLimit { per_second: number(5), burst: number(5) };
        let policy = RatePolicy { rate, clock: clock.clock(), shared: Some(shared.clone()) };
        Gateway { shared, limit: policy.limit(&KEY) }
    }

    /// Floods all gateways with requests every 10 ms, and exchanges what they spent every `delay`; returns the number of
    /// accepted requests.
    fn flood(clock: &ManualClock, gateways: &[Gateway], seconds: u32, delay: u32) -> u32 {
        let mut accepted = 0;
        for step in 1..=seconds * 100 {
            clock.advance(Duration::from_millis(10));
            for gateway in gateways {
                accepted += u32::from(gateway.limit.spend(NonZeroU32::MIN).is_ok());
            }
            if (step * 10) % delay == 0 {
                for (from, gateway) in gateways.iter().enumerate() {
                    for (lane, spent) in gateway.shared.take_spent() {
                        let others = gateways.iter().enumerate().filter(|(to, _)| *to != from);
                        others.for_each(|(_, other)| other.shared.charge(lane, spent));
                    }
                }
            }
        }
        accepted
    }

    #[test]
    fn gateways_share_a_rate_however_late_they_hear_of_each_other() {
        for (count, delay) in [(1, 50), (2, 50), (2, 500), (3, 100), (10, 500)] {
            let clock = ManualClock::new();
            let gateways: Vec<Gateway> = (0..count).map(|_| gateway(&clock, count)).collect();
            // The bursts of all gateways come first, and are paid back.
            flood(&clock, &gateways, 10, delay);
            let accepted = flood(&clock, &gateways, 60, delay);
            assert!((290..=310).contains(&accepted), "{count} gateways, {delay} ms: {accepted} in 60 s");
        }
    }

    #[test]
    fn gateways_without_a_report_give_the_rate_each() {
        let clock = ManualClock::new();
        let gateways: Vec<Gateway> = (0..2).map(|_| gateway(&clock, 2)).collect();
        let accepted = flood(&clock, &gateways, 60, u32::MAX);
        assert!(accepted > 590, "{accepted}");
        // Counted twice, each gives half.
        let clock = ManualClock::new();
        let gateways: Vec<Gateway> = (0..2).map(|_| gateway(&clock, 2)).collect();
        for gateway in &gateways {
            gateway.shared.set_gateways(number(2), number(2));
        }
        let accepted = flood(&clock, &gateways, 60, u32::MAX);
        assert!((290..=310).contains(&accepted), "{accepted}");
    }

    #[test]
    fn report_of_another_gateway_closes_a_token_for_its_bursts_at_most() {
        let clock = ManualClock::new();
        let gateway = gateway(&clock, 2);
        gateway.shared.charge(Lane::of(&KEY), NonZeroU32::MAX);
        // Two bursts of five at five a second, less the one that the bucket then holds.
        assert_eq!(gateway.limit.spend(NonZeroU32::MIN), Err(Duration::from_millis(1200)));
        clock.advance(Duration::from_millis(1200));
        gateway.limit.spend(NonZeroU32::MIN).expect("paid back");
        // A client that is not known here is no error.
        gateway.shared.charge(Lane::of(&TokenKey::of_digest([8; 32])), NonZeroU32::MIN);
    }

    #[test]
    fn session_larger_than_a_weighted_bucket_is_taken_from_a_full_one() {
        let clock = ManualClock::new();
        let gateway = gateway(&clock, 3);
        gateway.shared.set_gateways(number(3), number(3));
        gateway.limit.spend(number(4)).expect("the bucket is full");
        let wait = gateway.limit.spend(number(4)).expect_err("12 of 5 are used");
        assert_eq!(wait, Duration::from_millis(2400), "until it is full");
        assert_eq!(gateway.shared.take_spent(), [(Lane::of(&KEY), number(4))], "reported as accepted");
    }

    #[test]
    fn removed_tokens_are_forgotten() {
        let clock = ManualClock::new();
        let Gateway { shared, limit } = gateway(&clock, 2);
        drop(limit);
        shared.charge(Lane::of(&KEY), NonZeroU32::MIN);
        assert!(shared.state().limits.is_empty());
    }

    #[test]
    fn seconds_are_rounded_up() {
        for (ms, seconds) in [(0, 1), (1, 1), (1000, 1), (1001, 2), (59_000, 59)] {
            assert_eq!(seconds_up(Duration::from_millis(ms)).get(), seconds);
        }
    }
}
