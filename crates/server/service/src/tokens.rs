//! Who asks: bearer tokens by the list of the file (`veiloc_service::auth`), each with its own allowance.

use std::collections::HashMap;
use std::fmt;
use std::num::{NonZeroU32, NonZeroU64};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use crate::auth::{Entry, Moment, TokenKey, TokenList};
use crate::clock::Clock;
use crate::telemetry::Trail;
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use governor::state::{InMemoryState, NotKeyed};
use governor::{NotUntil, Quota, RateLimiter};

use crate::options::RateLimit;
use crate::problem::Problem;

/// Who asks.
pub(crate) struct Caller {
    key: TokenKey,
    /// What the operator calls it; empty where no token is asked for.
    name: Arc<str>,
    /// Its line of the file; `None` where no token is asked for.
    entry: Option<Entry>,
    allowance: Arc<Allowance>,
}

/// How often a token may ask. It outlives a change of what else the token is worth.
struct Allowance {
    limiter: RateLimiter<NotKeyed, InMemoryState, Clock>,
    clock: Clock,
    /// What it lets through at once.
    burst: NonZeroU32,
}

impl Allowance {
    fn new(rate: RateLimit, clock: &Clock) -> Arc<Self> {
        let quota = Quota::per_second(rate.per_second).allow_burst(rate.burst);
        let limiter = RateLimiter::direct_with_clock(quota, clock.clone());
        Arc::new(Self { limiter, clock: clock.clone(), burst: rate.burst })
    }

    fn used_up(&self, until: &NotUntil<Instant>) -> Problem {
        Problem::RateLimited { retry_after: seconds_up(until.wait_time_from(self.clock.now())) }
    }
}

// Neither token nor hash is ever printed.
impl fmt::Debug for Caller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Caller")
    }
}

impl Caller {
    /// Says in the trail of a request whose it is.
    pub(crate) fn sign(&self, trail: &Trail) {
        if !self.name.is_empty() {
            trail.asked_by(self.name.clone());
        }
    }

    /// Which token it brought.
    pub(crate) const fn key(&self) -> TokenKey {
        self.key
    }

    /// Whether it may read the metrics.
    pub(crate) fn is_operator(&self) -> bool {
        self.entry.as_ref().is_none_or(|entry| entry.operator)
    }

    /// Whether it may ask for a map of this name, whether or not there is one.
    pub(crate) fn may_ask_for(&self, map: &str) -> bool {
        self.entry.as_ref().is_none_or(|entry| entry.may_ask_for(map))
    }

    /// Takes one request from the allowance.
    pub(crate) fn spend(&self) -> Result<(), Problem> {
        self.allowance.limiter.check().map_err(|until| self.allowance.used_up(&until))
    }

    /// Takes the rest of a session of so many images, of which the request itself has taken one: as much as they would one
    /// by one, all or nothing.
    pub(crate) fn spend_session(&self, images: usize) -> Result<(), Problem> {
        let too_long = || Problem::SessionTooLong { most: self.allowance.burst };
        let rest = u32::try_from(images.saturating_sub(1)).map_err(|_| too_long())?;
        let Some(rest) = NonZeroU32::new(rest) else { return Ok(()) };
        // What is never there at once must not be waited for.
        if rest >= self.allowance.burst {
            return Err(too_long());
        }
        let spent = self.allowance.limiter.check_n(rest).map_err(|_| too_long())?;
        spent.map_err(|until| self.allowance.used_up(&until))
    }
}

/// Whole seconds, rounded up, at least one: what `Retry-After` can say.
pub(crate) fn seconds_up(wait: Duration) -> NonZeroU64 {
    NonZeroU64::new(wait.as_secs() + u64::from(wait.subsec_nanos() > 0)).unwrap_or(NonZeroU64::MIN)
}

/// All who may ask.
pub(crate) enum Callers {
    /// Everybody, with one allowance for all.
    Anyone(Arc<Caller>),
    /// Who has one of these tokens, found by its hash. Why the time this takes tells nobody anything: `veiloc_service::auth`.
    Tokens(HashMap<TokenKey, Arc<Caller>>),
    /// Nobody, for want of a valid file of tokens.
    Closed,
}

impl Callers {
    /// No file of tokens.
    pub(crate) fn anyone(rate: RateLimit, clock: &Clock) -> Self {
        let key = TokenKey::of_digest([0; 32]);
        Self::Anyone(Arc::new(Caller {
            key,
            name: Arc::default(),
            entry: None,
            allowance: Allowance::new(rate, clock),
        }))
    }

    /// Those of a list. Tokens that were known before keep what is left of their allowance.
    pub(crate) fn of(list: &TokenList, rate: RateLimit, clock: &Clock, before: Option<&Self>) -> Self {
        let allowance = |key: &TokenKey| match before {
            Some(Self::Tokens(before)) => before.get(key).map(|caller| caller.allowance.clone()),
            _ => None,
        };
        let caller = |entry: &Entry| {
            let key = entry.key();
            let allowance = allowance(&key).unwrap_or_else(|| Allowance::new(rate, clock));
            let name = entry.name().into();
            (key, Arc::new(Caller { key, name, entry: Some(entry.clone()), allowance }))
        };
        Self::Tokens(list.entries().iter().map(caller).collect())
    }

    /// Whether tokens are asked for.
    pub(crate) const fn ask_for_tokens(&self) -> bool {
        !matches!(self, Self::Anyone(_))
    }

    /// Whether there is a valid file of tokens, or none is asked for.
    pub(crate) const fn is_closed(&self) -> bool {
        matches!(self, Self::Closed)
    }

    /// Whether no token is known.
    #[cfg(test)]
    pub(crate) fn is_nobody(&self) -> bool {
        matches!(self, Self::Tokens(all) if all.is_empty())
    }

    /// Who sent these headers.
    pub(crate) fn identify(&self, headers: &HeaderMap) -> Result<Arc<Caller>, Problem> {
        self.identify_at(headers, Moment::of(SystemTime::now()))
    }

    /// A token that has expired is no other than one that nobody knows.
    fn identify_at(&self, headers: &HeaderMap, now: Moment) -> Result<Arc<Caller>, Problem> {
        let callers = match self {
            Self::Anyone(caller) => return Ok(caller.clone()),
            Self::Closed => return Err(Problem::NoTokens),
            Self::Tokens(callers) => callers,
        };
        let token = headers.get(AUTHORIZATION).and_then(|value| bearer(value.as_bytes()));
        let key = TokenKey::of_token(token.ok_or(Problem::Unauthenticated)?);
        let known = callers.get(&key).filter(|c| c.entry.as_ref().is_none_or(|e| !e.has_expired(now)));
        known.cloned().ok_or(Problem::Unauthenticated)
    }
}

/// The token of `Bearer TOKEN`; the scheme's name in any case, as HTTP has it.
fn bearer(value: &[u8]) -> Option<&[u8]> {
    let (scheme, token) = value.split_at_checked(7)?;
    (scheme.eq_ignore_ascii_case(b"bearer ") && !token.is_empty()).then(|| token.trim_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::ManualClock;

    const RATE: RateLimit =
        RateLimit { per_second: NonZeroU32::MIN, burst: NonZeroU32::MIN.saturating_add(1) };
    /// `printf %s secret | openssl dgst -sha256`
    const SECRET: &str = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b";
    /// `printf %s other | openssl dgst -sha256`
    const OTHER: &str = "d9298a10d1b0735837dc4bd85dac641b0f3cef27a47e5d53a54f2f3f5b2fcffa";

    fn read(text: &str, before: Option<&Callers>) -> Callers {
        read_by(&Clock::default(), text, before)
    }

    fn read_by(clock: &Clock, text: &str, before: Option<&Callers>) -> Callers {
        Callers::of(&TokenList::parse(text.as_bytes()).expect("a file of tokens"), RATE, clock, before)
    }

    fn headers(value: &str) -> HeaderMap {
        [(AUTHORIZATION, value.parse().expect("a header"))].into_iter().collect()
    }

    #[test]
    fn only_who_has_a_token_is_known() {
        let text = format!("# phones\n\nphone {SECRET}\nops {} operator\n", OTHER.to_uppercase());
        let callers = read(&text, None);
        for (value, operator) in
            [("Bearer secret", false), ("bearer  secret ", false), ("BEARER other", true)]
        {
            let caller = callers.identify(&headers(value)).unwrap_or_else(|_| panic!("{value}"));
            assert_eq!(caller.is_operator(), operator, "{value}");
        }
        for value in
            ["", "Bearer", "Bearer ", "Bearer secret1", "Basic secret", "secret", &format!("Bearer {SECRET}")]
        {
            assert!(matches!(callers.identify(&headers(value)), Err(Problem::Unauthenticated)), "{value:?}");
        }
        assert!(callers.identify(&HeaderMap::new()).is_err());
        let nobody = read("# closed\nnobody\n", None);
        assert!(nobody.is_nobody() && nobody.identify(&headers("Bearer ")).is_err());
        assert!(matches!(Callers::Closed.identify(&headers("Bearer secret")), Err(Problem::NoTokens)));
    }

    #[test]
    fn an_expired_token_is_no_token_and_one_of_some_maps_asks_for_no_other() {
        let callers = read(&format!("phone {SECRET} maps=lobby expires=2027-01-31"), None);
        let end: Moment = "2027-01-31".parse().expect("a moment");
        let before = Moment::of_unix(end.unix() - 1);
        let caller = callers.identify_at(&headers("Bearer secret"), before).expect("still known");
        assert!(caller.may_ask_for("lobby") && !caller.may_ask_for("garage") && !caller.is_operator());
        let expired = callers.identify_at(&headers("Bearer secret"), end);
        assert!(matches!(expired, Err(Problem::Unauthenticated)));
        let anyone = Callers::anyone(RATE, &Clock::default()).identify(&HeaderMap::new()).expect("anyone");
        assert!(anyone.may_ask_for("garage") && anyone.is_operator());
    }

    #[test]
    fn an_allowance_ends_and_survives_a_reload() {
        let text = format!("phone {SECRET}\nother {OTHER}");
        let manual = ManualClock::new();
        let clock = manual.clock();
        let callers = read_by(&clock, &text, None);
        let caller = callers.identify(&headers("Bearer secret")).expect("known");
        caller.spend().expect("first");
        caller.spend().expect("burst");
        assert!(
            matches!(caller.spend(), Err(Problem::RateLimited { retry_after }) if retry_after.get() == 1)
        );
        // One asks no less because the other asked a lot.
        callers.identify(&headers("Bearer other")).expect("known").spend().expect("its own");
        let again = read_by(&clock, &format!("renamed {SECRET} maps=lobby"), Some(&callers));
        assert!(again.identify(&headers("Bearer secret")).expect("known").spend().is_err());
        assert!(again.identify(&headers("Bearer other")).is_err(), "taken from the file");
        // One a second.
        manual.advance(Duration::from_secs(1));
        caller.spend().expect("earned");
        caller.spend().expect_err("spent");
    }

    #[test]
    fn seconds_are_rounded_up() {
        for (ms, seconds) in [(0, 1), (1, 1), (1000, 1), (1001, 2), (59_000, 59)] {
            assert_eq!(seconds_up(Duration::from_millis(ms)).get(), seconds);
        }
    }
}
