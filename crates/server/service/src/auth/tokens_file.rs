//! The token file at run time: its last valid content, and how long that stays in force without a valid file.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::auth::TokenList;
use sha2::{Digest as _, Sha256};

use crate::auth::small_file::read_small_file;
use crate::auth::tokens::Callers;
use crate::error::ServerError;
use crate::queue::rates::RatePolicy;

/// The token file: its last valid content, and since when it has been invalid.
pub(crate) struct TokensFile {
    path: PathBuf,
    rates: RatePolicy,
    /// How long the last valid tokens stay in force without a valid file.
    stale: Duration,
    state: Mutex<State>,
}

struct State {
    /// SHA-256 of the last valid content.
    taken: [u8; 32],
    /// The last valid tokens, with the state of their rate limits.
    callers: Arc<Callers>,
    failing: Option<Failing>,
}

struct Failing {
    since: Instant,
    /// The last reported error; each error is reported once.
    reported: String,
    /// Whether the last valid tokens are no longer in force.
    closed: bool,
}

/// Result of checking the token file.
pub(crate) enum TokensCheck {
    /// No change.
    Unchanged,
    /// New valid tokens, in force from now on.
    Replaced(Arc<Callers>),
    /// A new error; the previous tokens stay in force.
    Invalid(ServerError),
    /// The file has been invalid for too long: all queries are refused from now on.
    Expired(ServerError),
}

impl TokensFile {
    /// Reads the file for the first time.
    pub(crate) fn open(
        path: &Path,
        rates: RatePolicy,
        stale: Duration,
    ) -> Result<(Self, Arc<Callers>), ServerError> {
        let bytes = read(path)?;
        let callers = Arc::new(Callers::of(&parse(&bytes, path)?, &rates, None));
        let state = Mutex::new(State { taken: hash(&bytes), callers: callers.clone(), failing: None });
        Ok((Self { path: path.to_owned(), rates, stale, state }, callers))
    }

    /// Whether the current file is invalid.
    pub(crate) fn is_failing(&self) -> bool {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).failing.is_some()
    }

    /// Reads the file again. The content is compared, not the time stamp, so that no revocation can be missed.
    pub(crate) fn check(&self, now: Instant) -> TokensCheck {
        let read = read(&self.path);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *state;
        let valid = read.and_then(|bytes| {
            let digest = hash(&bytes);
            if digest == state.taken {
                return Ok((digest, state.callers.clone()));
            }
            let list = parse(&bytes, &self.path)?;
            let callers = Callers::of(&list, &self.rates, Some(&state.callers));
            Ok((digest, Arc::new(callers)))
        });
        match valid {
            Ok((digest, callers)) => {
                let same = digest == state.taken && state.failing.is_none();
                (state.taken, state.callers, state.failing) = (digest, callers.clone(), None);
                if same { TokensCheck::Unchanged } else { TokensCheck::Replaced(callers) }
            }
            Err(error) => {
                let reported = error.to_string();
                let since = state.failing.as_ref().map_or(now, |failing| failing.since);
                let failing =
                    state.failing.get_or_insert(Failing { since, reported: String::new(), closed: false });
                let news = failing.reported != reported;
                failing.reported = reported;
                if !failing.closed && now.duration_since(failing.since) >= self.stale {
                    failing.closed = true;
                    return TokensCheck::Expired(error);
                }
                if news { TokensCheck::Invalid(error) } else { TokensCheck::Unchanged }
            }
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, ServerError> {
    read_small_file(path).map_err(|source| ServerError::Io { path: path.to_owned(), source })
}

fn parse(bytes: &[u8], path: &Path) -> Result<TokenList, ServerError> {
    TokenList::parse(bytes).map_err(|source| ServerError::Tokens { path: path.to_owned(), source })
}

/// SHA-256.
pub(crate) fn hash(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::RateLimit;
    use crate::queue::clock::Clock;
    use std::num::NonZeroU32;

    const RATE: RateLimit = RateLimit { per_second: NonZeroU32::MIN, burst: NonZeroU32::MIN };
    const SECRET: &str = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b";
    const STALE: Duration = Duration::from_secs(300);

    fn open(path: &Path) -> TokensFile {
        let rates = RatePolicy { rate: RATE, clock: Clock::default() };
        TokensFile::open(path, rates, STALE).expect("a file of tokens").0
    }

    /// A deleted, empty or invalid file is reported once, tolerated for the configured time, then all queries are
    /// refused until the file is valid again.
    #[test]
    fn invalid_token_file_is_tolerated_for_limited_time() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        let good = format!("phone {SECRET}\n");
        for wrong in
            [None, Some(""), Some("# nobody any more\n"), Some("phone hunter2\n"), Some("\u{0}\u{1}")]
        {
            std::fs::write(&path, &good).expect("written");
            let file = open(&path);
            let start = Instant::now();
            assert!(matches!(file.check(start), TokensCheck::Unchanged) && !file.is_failing());
            match wrong {
                Some(text) => std::fs::write(&path, text).expect("written"),
                None => std::fs::remove_file(&path).expect("removed"),
            }
            let TokensCheck::Invalid(error) = file.check(start) else { panic!("{wrong:?} is no error") };
            assert!(
                error.to_string().contains("tokens") && !error.to_string().contains("hunter2"),
                "{error}"
            );
            assert!(file.is_failing());
            assert!(
                matches!(file.check(start + STALE / 2), TokensCheck::Unchanged),
                "reported once, tokens still in force"
            );
            assert!(matches!(file.check(start + STALE), TokensCheck::Expired(_)), "{wrong:?}");
            assert!(matches!(file.check(start + 2 * STALE), TokensCheck::Unchanged));
            std::fs::write(&path, &good).expect("written");
            assert!(
                matches!(file.check(start + 2 * STALE), TokensCheck::Replaced(_)) && !file.is_failing(),
                "{wrong:?}"
            );
        }
        // The line `nobody` is a valid file and in force at once.
        let file = open(&path);
        std::fs::write(&path, "nobody\n").expect("written");
        assert!(matches!(file.check(Instant::now()), TokensCheck::Replaced(callers) if callers.is_empty()));
    }
}
