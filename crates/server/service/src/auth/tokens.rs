//! Authentication by bearer tokens from the token file (`veiloc_service::auth`), with one rate limit per token.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use crate::auth::{Timestamp, TokenEntry, TokenKey, TokenList};
use crate::telemetry::RequestContext;
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;

use crate::http::problem::Problem;
use crate::queue::rates::{RatePolicy, TokenRateLimit, seconds_up};

/// The client of a request.
pub(crate) struct Caller {
    key: TokenKey,
    /// Name that the operator gave the token; empty if no token is required.
    name: Arc<str>,
    /// The line of the token file; `None` if no token is required.
    entry: Option<TokenEntry>,
    /// `None` for a gateway, which limits the rates of its clients itself.
    rate_limit: Option<Arc<TokenRateLimit>>,
}

// Never print the token or its hash.
impl fmt::Debug for Caller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Caller")
    }
}

impl Caller {
    /// Records the name of the token in the context of a request.
    pub(crate) fn record_in(&self, context: &RequestContext) {
        if !self.name.is_empty() {
            context.set_token(self.name.clone());
        }
    }

    /// Hash of the token.
    pub(crate) const fn key(&self) -> TokenKey {
        self.key
    }

    /// Whether the token may read the metrics.
    pub(crate) fn is_operator(&self) -> bool {
        self.entry.as_ref().is_none_or(|entry| entry.operator)
    }

    /// Name of the token.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Whether the token may write content anchors; without tokens nobody may.
    pub(crate) fn writes_anchors(&self) -> bool {
        self.entry.as_ref().is_some_and(|entry| entry.anchors)
    }

    /// Whether the client is a gateway.
    pub(crate) fn is_gateway(&self) -> bool {
        self.entry.as_ref().is_some_and(|entry| entry.gateway)
    }

    /// Whether the token may use a map of this name; the map need not exist.
    pub(crate) fn allows_map(&self, map: &str) -> bool {
        self.entry.as_ref().is_none_or(|entry| entry.allows_map(map))
    }

    /// Takes one request from the rate limit.
    pub(crate) fn spend(&self) -> Result<(), Problem> {
        self.rate_limit.as_ref().map_or(Ok(()), |limit| limit.spend(NonZeroU32::MIN).map_err(exceeded))
    }

    /// Takes the remaining images of a session from the rate limit; one was taken with the request. A session costs
    /// as much as its images one by one, and is accepted completely or not at all.
    pub(crate) fn spend_session(&self, images: usize) -> Result<(), Problem> {
        let Some(limit) = &self.rate_limit else { return Ok(()) };
        let burst = limit.burst();
        let too_long = || Problem::SessionTooLong { most: burst };
        let rest = u32::try_from(images.saturating_sub(1)).map_err(|_| too_long())?;
        let Some(rest) = NonZeroU32::new(rest) else { return Ok(()) };
        // More than the burst size is never available at once, so waiting would not help.
        if rest >= burst {
            return Err(too_long());
        }
        limit.spend(rest).map_err(exceeded)
    }
}

fn exceeded(wait: Duration) -> Problem {
    Problem::RateLimited { retry_after: seconds_up(wait) }
}

/// How a token of the file changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TokenChange {
    Added,
    Removed,
    /// Another token, or other maps, permissions or another expiry under the same name.
    Replaced,
}

impl TokenChange {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Added => "added",
            Self::Removed => "removed",
            Self::Replaced => "replaced",
        }
    }
}

/// The clients that may query.
pub(crate) enum Callers {
    /// Any client, with one common rate limit.
    Unrestricted(Arc<Caller>),
    /// Clients with one of these tokens, looked up by hash. `veiloc_service::auth` explains why the duration of the
    /// lookup reveals nothing.
    Tokens(HashMap<TokenKey, Arc<Caller>>),
    /// No client, because there is no valid token file.
    Closed,
}

impl Callers {
    /// Without a token file.
    pub(crate) fn unrestricted(rates: &RatePolicy) -> Self {
        let key = TokenKey::of_digest([0; 32]);
        Self::Unrestricted(Arc::new(Caller {
            key,
            name: Arc::default(),
            entry: None,
            rate_limit: Some(rates.limit()),
        }))
    }

    /// The clients of a token list. Tokens known before keep the state of their rate limit.
    pub(crate) fn of(list: &TokenList, rates: &RatePolicy, before: Option<&Self>) -> Self {
        let rate_limit = |key: &TokenKey| match before {
            Some(Self::Tokens(before)) => before.get(key).and_then(|caller| caller.rate_limit.clone()),
            _ => None,
        };
        let caller = |entry: &TokenEntry| {
            let key = entry.key();
            let rate_limit = (!entry.gateway).then(|| rate_limit(&key).unwrap_or_else(|| rates.limit()));
            let name = entry.name().into();
            (key, Arc::new(Caller { key, name, entry: Some(entry.clone()), rate_limit }))
        };
        Self::Tokens(list.entries().iter().map(caller).collect())
    }

    /// The tokens that differ from those before, by name, and how: for the log.
    pub(crate) fn changes_since(&self, before: &Self) -> Vec<(String, TokenChange)> {
        let (before, now) = (before.entries_by_name(), self.entries_by_name());
        let names: BTreeSet<&str> = before.keys().chain(now.keys()).copied().collect();
        let change = |name: &str| match (before.get(name), now.get(name)) {
            (None, _) => Some(TokenChange::Added),
            (_, None) => Some(TokenChange::Removed),
            (Some(before), Some(now)) => (before != now).then_some(TokenChange::Replaced),
        };
        names.into_iter().filter_map(|name| Some((name.to_owned(), change(name)?))).collect()
    }

    /// The lines of each name in an order of their own; older files may have several.
    fn entries_by_name(&self) -> BTreeMap<&str, BTreeSet<String>> {
        let mut all: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        if let Self::Tokens(callers) = self {
            for entry in callers.values().filter_map(|caller| caller.entry.as_ref()) {
                all.entry(entry.name()).or_default().insert(entry.to_string());
            }
        }
        all
    }

    /// Whether tokens are required.
    pub(crate) const fn require_tokens(&self) -> bool {
        !matches!(self, Self::Unrestricted(_))
    }

    /// Whether the service refuses all clients, for lack of a valid token file.
    pub(crate) const fn is_closed(&self) -> bool {
        matches!(self, Self::Closed)
    }

    /// Whether the list of tokens is empty.
    #[cfg(test)]
    pub(crate) fn is_empty(&self) -> bool {
        matches!(self, Self::Tokens(all) if all.is_empty())
    }

    /// Identifies the client that sent these headers.
    pub(crate) fn identify(&self, headers: &HeaderMap) -> Result<Arc<Caller>, Problem> {
        self.identify_at(headers, Timestamp::of(SystemTime::now()))
    }

    /// An expired token is treated like an unknown one.
    fn identify_at(&self, headers: &HeaderMap, now: Timestamp) -> Result<Arc<Caller>, Problem> {
        let callers = match self {
            Self::Unrestricted(caller) => return Ok(caller.clone()),
            Self::Closed => return Err(Problem::NoTokens),
            Self::Tokens(callers) => callers,
        };
        let token = headers.get(AUTHORIZATION).and_then(|value| bearer(value.as_bytes()));
        let key = TokenKey::of_token(token.ok_or(Problem::Unauthenticated)?);
        let known = callers.get(&key).filter(|c| c.entry.as_ref().is_none_or(|e| !e.has_expired(now)));
        known.cloned().ok_or(Problem::Unauthenticated)
    }
}

/// The token of `Bearer TOKEN`; the scheme is case-insensitive, as in HTTP.
fn bearer(value: &[u8]) -> Option<&[u8]> {
    let (scheme, token) = value.split_at_checked(7)?;
    (scheme.eq_ignore_ascii_case(b"bearer ") && !token.is_empty()).then(|| token.trim_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::RateLimit;
    use crate::queue::clock::{Clock, ManualClock};

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
        Callers::of(&TokenList::parse(text.as_bytes()).expect("a file of tokens"), &rates(clock), before)
    }

    fn rates(clock: &Clock) -> RatePolicy {
        RatePolicy { rate: RATE, clock: clock.clone() }
    }

    fn headers(value: &str) -> HeaderMap {
        [(AUTHORIZATION, value.parse().expect("a header"))].into_iter().collect()
    }

    #[test]
    fn only_valid_tokens_authenticate() {
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
        let closed = read("# closed\nnobody\n", None);
        assert!(closed.is_empty() && closed.identify(&headers("Bearer ")).is_err());
        assert!(matches!(Callers::Closed.identify(&headers("Bearer secret")), Err(Problem::NoTokens)));
    }

    #[test]
    fn token_expiry_and_map_scope_are_enforced() {
        let callers = read(&format!("phone {SECRET} maps=lobby expires=2027-01-31"), None);
        let end: Timestamp = "2027-01-31".parse().expect("a timestamp");
        let before = Timestamp::of_unix(end.unix() - 1);
        let caller = callers.identify_at(&headers("Bearer secret"), before).expect("still known");
        assert!(caller.allows_map("lobby") && !caller.allows_map("garage") && !caller.is_operator());
        let expired = callers.identify_at(&headers("Bearer secret"), end);
        assert!(matches!(expired, Err(Problem::Unauthenticated)));
        let unrestricted =
            Callers::unrestricted(&rates(&Clock::default())).identify(&HeaderMap::new()).expect("any client");
        assert!(unrestricted.allows_map("garage") && unrestricted.is_operator());
    }

    #[test]
    fn changed_tokens_are_named() {
        let before = read(&format!("phone {SECRET}\nold {OTHER}"), None);
        let now = read(&format!("phone {SECRET} maps=lobby\nnew {OTHER}"), None);
        let (phone, added, old) = (
            ("phone".to_owned(), TokenChange::Replaced),
            ("new".to_owned(), TokenChange::Added),
            ("old".to_owned(), TokenChange::Removed),
        );
        assert_eq!(now.changes_since(&before), [added.clone(), old, phone]);
        assert_eq!(now.changes_since(&now), []);
        let again = now.changes_since(&Callers::Closed);
        assert_eq!(again, [added, ("phone".to_owned(), TokenChange::Added)]);
    }

    #[test]
    fn rate_limit_is_enforced_and_survives_reload() {
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
        // The requests of one token do not count against another.
        callers.identify(&headers("Bearer other")).expect("known").spend().expect("its own");
        let again = read_by(&clock, &format!("renamed {SECRET} maps=lobby"), Some(&callers));
        assert!(again.identify(&headers("Bearer secret")).expect("known").spend().is_err());
        assert!(again.identify(&headers("Bearer other")).is_err(), "removed from the file");
        // One request per second.
        manual.advance(Duration::from_secs(1));
        caller.spend().expect("earned");
        caller.spend().expect_err("spent");
    }
}
