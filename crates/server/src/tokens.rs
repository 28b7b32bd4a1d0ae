//! Who may ask: bearer tokens, kept as hashes, each with its own allowance.
//!
//! # The file
//! One token a line: a name for people, the SHA-256 of the token in hexadecimal, and optionally `operator`, which also
//! allows reading the metrics. Empty lines and lines beginning with `#` do not count. A file without tokens is an error,
//! unless the line `nobody` says that it is meant.
//!
//! A token must be a long random string (`openssl rand -hex 32`): then its plain hash can neither be reversed nor
//! guessed, and salting or stretching would only cost time on every request.

use std::collections::HashMap;
use std::fmt;
use std::num::{NonZeroU32, NonZeroU64};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use governor::clock::{Clock, DefaultClock};
use governor::{DefaultDirectRateLimiter, NotUntil, Quota, RateLimiter};
use sha2::{Digest as _, Sha256};
use veiloc_admission::TokenKey;

use crate::error::ServerError;
use crate::options::RateLimit;
use crate::problem::Problem;

/// What a token allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// Localization, maps and profiles.
    Client,
    /// The same and the metrics.
    Operator,
}

/// Who asks.
pub(crate) struct Caller {
    digest: [u8; 32],
    pub(crate) role: Role,
    limiter: DefaultDirectRateLimiter,
    /// What the allowance lets through at once.
    burst: NonZeroU32,
}

// Neither token nor hash is ever printed.
impl fmt::Debug for Caller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Caller({:?})", self.role)
    }
}

impl Caller {
    fn new(digest: [u8; 32], role: Role, rate: RateLimit) -> Self {
        let quota = Quota::per_second(rate.per_second).allow_burst(rate.burst);
        Self { digest, role, limiter: RateLimiter::direct(quota), burst: rate.burst }
    }

    /// Which token it brought.
    pub(crate) const fn key(&self) -> TokenKey {
        TokenKey::of_digest(self.digest)
    }

    /// Takes one request from the allowance.
    pub(crate) fn spend(&self) -> Result<(), Problem> {
        self.limiter.check().map_err(|until| used_up(&until))
    }

    /// Takes the rest of a session of so many images, of which the request itself has taken one: as much as they would one
    /// by one, all or nothing.
    pub(crate) fn spend_session(&self, images: usize) -> Result<(), Problem> {
        let too_long = || Problem::SessionTooLong { most: self.burst };
        let rest = u32::try_from(images.saturating_sub(1)).map_err(|_| too_long())?;
        let Some(rest) = NonZeroU32::new(rest) else { return Ok(()) };
        // What is never there at once must not be waited for.
        if rest >= self.burst {
            return Err(too_long());
        }
        self.limiter.check_n(rest).map_err(|_| too_long())?.map_err(|until| used_up(&until))
    }
}

fn used_up(until: &NotUntil<<DefaultClock as Clock>::Instant>) -> Problem {
    let wait = until.wait_time_from(DefaultClock::default().now());
    Problem::RateLimited { retry_after: seconds_up(wait) }
}

/// Whole seconds, rounded up, at least one: what `Retry-After` can say.
pub(crate) fn seconds_up(wait: Duration) -> NonZeroU64 {
    NonZeroU64::new(wait.as_secs() + u64::from(wait.subsec_nanos() > 0)).unwrap_or(NonZeroU64::MIN)
}

/// All who may ask.
pub(crate) enum Callers {
    /// Everybody, with one allowance for all.
    Anyone(Arc<Caller>),
    /// Who has one of these tokens, found by its hash. Whoever tries tokens cannot choose their hashes, so how long the
    /// search takes tells them nothing.
    Tokens(HashMap<TokenKey, Arc<Caller>>),
    /// Nobody, for want of a valid file of tokens.
    Closed,
}

impl Callers {
    /// No file of tokens.
    pub(crate) fn anyone(rate: RateLimit) -> Self {
        Self::Anyone(Arc::new(Caller::new([0; 32], Role::Operator, rate)))
    }

    /// Reads what the file of tokens at `path` holds. Tokens that were known before keep what is left of their allowance.
    ///
    /// # Errors
    /// A line that is none, and a file without any token: an unfinished write looks like that. That nobody may ask is said
    /// by the line `nobody`.
    pub(crate) fn parse(
        bytes: &[u8],
        path: &Path,
        rate: RateLimit,
        before: Option<&Self>,
    ) -> Result<Self, ServerError> {
        let at = |line, reason| ServerError::Tokens { path: path.to_owned(), line, reason };
        let text = std::str::from_utf8(bytes).map_err(|_| at(1, "the file is no text"))?;
        let mut all: HashMap<TokenKey, Arc<Caller>> = HashMap::new();
        let mut nobody = false;
        for (i, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            if line == "nobody" {
                nobody = true;
                continue;
            }
            let wrong = |reason| at(i + 1, reason);
            let (digest, role) = parse(line).map_err(wrong)?;
            let known = match before {
                Some(Self::Tokens(before)) => {
                    before.get(&TokenKey::of_digest(digest)).filter(|c| c.role == role)
                }
                _ => None,
            };
            let caller = known.cloned().unwrap_or_else(|| Arc::new(Caller::new(digest, role, rate)));
            if all.insert(TokenKey::of_digest(digest), caller).is_some() {
                return Err(wrong("this token is there twice"));
            }
        }
        match (nobody, all.is_empty()) {
            (true, false) => Err(at(1, "there are tokens, and the line `nobody` says that there are none")),
            (false, true) => Err(ServerError::NoTokens { path: path.to_owned() }),
            _ => Ok(Self::Tokens(all)),
        }
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
        let callers = match self {
            Self::Anyone(caller) => return Ok(caller.clone()),
            Self::Closed => return Err(Problem::NoTokens),
            Self::Tokens(callers) => callers,
        };
        let token = headers.get(AUTHORIZATION).and_then(|value| bearer(value.as_bytes()));
        let digest: [u8; 32] = Sha256::digest(token.ok_or(Problem::Unauthenticated)?).into();
        callers.get(&TokenKey::of_digest(digest)).cloned().ok_or(Problem::Unauthenticated)
    }
}

/// The token of `Bearer TOKEN`; the scheme's name in any case, as HTTP has it.
fn bearer(value: &[u8]) -> Option<&[u8]> {
    let (scheme, token) = value.split_at_checked(7)?;
    (scheme.eq_ignore_ascii_case(b"bearer ") && !token.is_empty()).then(|| token.trim_ascii())
}

fn parse(line: &str) -> Result<([u8; 32], Role), &'static str> {
    let mut words = line.split_whitespace();
    let (Some(_name), Some(hex)) = (words.next(), words.next()) else {
        return Err("a name and the SHA-256 of the token are needed, with a space between them");
    };
    let role = match (words.next(), words.next()) {
        (None, _) => Role::Client,
        (Some("operator"), None) => Role::Operator,
        _ => return Err("only the word `operator` may follow the SHA-256"),
    };
    let digit = |c: u8| (c as char).to_digit(16);
    let hex = hex.as_bytes();
    let mut digest = [0; 32];
    if hex.len() != 64 || !hex.iter().all(|c| digit(*c).is_some()) {
        return Err("the second word is not a SHA-256: 64 hexadecimal digits (and never the token itself)");
    }
    for (byte, pair) in digest.iter_mut().zip(hex.chunks_exact(2)) {
        *byte = pair.iter().fold(0, |value, c| value << 4 | digit(*c).unwrap_or(0) as u8);
    }
    Ok((digest, role))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: RateLimit =
        RateLimit { per_second: NonZeroU32::MIN, burst: NonZeroU32::MIN.saturating_add(1) };
    /// `printf %s secret | openssl dgst -sha256`
    const SECRET: &str = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b";
    /// `printf %s other | openssl dgst -sha256`
    const OTHER: &str = "d9298a10d1b0735837dc4bd85dac641b0f3cef27a47e5d53a54f2f3f5b2fcffa";

    fn read(text: &str, before: Option<&Callers>) -> Result<Callers, ServerError> {
        Callers::parse(text.as_bytes(), Path::new("tokens"), RATE, before)
    }

    fn headers(value: &str) -> HeaderMap {
        [(AUTHORIZATION, value.parse().expect("a header"))].into_iter().collect()
    }

    #[test]
    fn only_who_has_a_token_is_known() {
        let text = format!("# phones\n\nphone {SECRET}\nops {} operator\n", OTHER.to_uppercase());
        let callers = read(&text, None).expect("a file of tokens");
        for (value, role) in [
            ("Bearer secret", Role::Client),
            ("bearer  secret ", Role::Client),
            ("BEARER other", Role::Operator),
        ] {
            let caller = callers.identify(&headers(value)).unwrap_or_else(|_| panic!("{value}"));
            assert_eq!(caller.role, role, "{value}");
        }
        for value in
            ["", "Bearer", "Bearer ", "Bearer secret1", "Basic secret", "secret", &format!("Bearer {SECRET}")]
        {
            assert!(matches!(callers.identify(&headers(value)), Err(Problem::Unauthenticated)), "{value:?}");
        }
        assert!(callers.identify(&HeaderMap::new()).is_err());
        let nobody = read("# closed\nnobody\n", None).expect("nobody");
        assert!(nobody.is_nobody() && nobody.identify(&headers("Bearer ")).is_err());
        assert!(matches!(Callers::Closed.identify(&headers("Bearer secret")), Err(Problem::NoTokens)));
    }

    #[test]
    fn wrong_lines_are_named_and_never_repeated() {
        for (line, part) in [
            ("phone", "a name and the SHA-256"),
            ("phone hunter2", "64 hexadecimal digits"),
            (&format!("phone {SECRET} admin"), "operator"),
            (&format!("phone {SECRET} operator too"), "operator"),
            (&format!("a {SECRET}\nb {SECRET}"), "twice"),
            (&format!("a {SECRET}\nnobody"), "nobody"),
        ] {
            let error = read(line, None).err().expect("refused").to_string();
            assert!(error.contains(part) && error.contains("line "), "{error}");
            assert!(!error.contains("hunter2") && !error.contains(&SECRET[..8]), "{error}");
        }
        for empty in ["", "\n\n", "# phones\n"] {
            assert!(matches!(read(empty, None), Err(ServerError::NoTokens { .. })), "{empty:?}");
        }
    }

    #[test]
    fn an_allowance_ends_and_survives_a_reload() {
        let text = format!("phone {SECRET}\nother {OTHER}");
        let callers = read(&text, None).expect("tokens");
        let caller = callers.identify(&headers("Bearer secret")).expect("known");
        caller.spend().expect("first");
        caller.spend().expect("burst");
        assert!(matches!(caller.spend(), Err(Problem::RateLimited { .. })));
        // One asks no less because the other asked a lot.
        callers.identify(&headers("Bearer other")).expect("known").spend().expect("its own");
        let again = read(&format!("renamed {SECRET}"), Some(&callers)).expect("tokens");
        assert!(again.identify(&headers("Bearer secret")).expect("known").spend().is_err());
        assert!(again.identify(&headers("Bearer other")).is_err(), "taken from the file");
    }

    #[test]
    fn seconds_are_rounded_up() {
        for (ms, seconds) in [(0, 1), (1, 1), (1000, 1), (1001, 2), (59_000, 59)] {
            assert_eq!(seconds_up(Duration::from_millis(ms)).get(), seconds);
        }
    }
}
