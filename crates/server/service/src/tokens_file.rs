//! The file of tokens while the service runs: its last valid content, and how long that holds without a valid file.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::auth::TokenList;
use crate::clock::Clock;
use sha2::{Digest as _, Sha256};

use crate::error::ServerError;
use crate::options::RateLimit;
use crate::tokens::Callers;

/// The file of tokens: its last valid content, and since when it has none.
pub(crate) struct TokensFile {
    path: PathBuf,
    rate: RateLimit,
    clock: Clock,
    /// How long the last valid set holds without a valid file.
    stale: Duration,
    state: Mutex<State>,
}

struct State {
    /// SHA-256 of the last valid content.
    taken: [u8; 32],
    /// The last valid set, with what is left of each allowance.
    callers: Arc<Callers>,
    failing: Option<Failing>,
}

struct Failing {
    since: Instant,
    /// What is wrong, told once.
    told: String,
    /// Whether the last valid set holds no more.
    closed: bool,
}

/// What a look at the file of tokens came to.
pub(crate) enum Look {
    /// Nothing to do.
    Same,
    /// Another valid set, from now on.
    Taken(Arc<Callers>),
    /// Something is wrong with it that was not told yet; what held before the look still does.
    Refused(ServerError),
    /// It has been wrong for too long: from now on nobody may ask.
    Closed(ServerError),
}

impl TokensFile {
    /// Reads the file for the first time.
    pub(crate) fn open(
        path: &Path,
        rate: RateLimit,
        clock: &Clock,
        stale: Duration,
    ) -> Result<(Self, Arc<Callers>), ServerError> {
        let bytes = read(path)?;
        let callers = Arc::new(Callers::of(&parse(&bytes, path)?, rate, clock, None));
        let state = Mutex::new(State { taken: hash(&bytes), callers: callers.clone(), failing: None });
        Ok((Self { path: path.to_owned(), rate, clock: clock.clone(), stale, state }, callers))
    }

    /// Whether its newest state could not be used.
    pub(crate) fn is_failing(&self) -> bool {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).failing.is_some()
    }

    /// Reads it again. It is small, so it is read and not looked at: no time stamp can hide a revocation.
    pub(crate) fn look(&self, now: Instant) -> Look {
        let read = read(&self.path);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *state;
        let valid = read.and_then(|bytes| {
            let digest = hash(&bytes);
            if digest == state.taken {
                return Ok((digest, state.callers.clone()));
            }
            let list = parse(&bytes, &self.path)?;
            let callers = Callers::of(&list, self.rate, &self.clock, Some(&state.callers));
            Ok((digest, Arc::new(callers)))
        });
        match valid {
            Ok((digest, callers)) => {
                let same = digest == state.taken && state.failing.is_none();
                (state.taken, state.callers, state.failing) = (digest, callers.clone(), None);
                if same { Look::Same } else { Look::Taken(callers) }
            }
            Err(error) => {
                let told = error.to_string();
                let since = state.failing.as_ref().map_or(now, |failing| failing.since);
                let failing =
                    state.failing.get_or_insert(Failing { since, told: String::new(), closed: false });
                let news = failing.told != told;
                failing.told = told;
                if !failing.closed && now.duration_since(failing.since) >= self.stale {
                    failing.closed = true;
                    return Look::Closed(error);
                }
                if news { Look::Refused(error) } else { Look::Same }
            }
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, ServerError> {
    std::fs::read(path).map_err(|source| ServerError::Io { path: path.to_owned(), source })
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
    use std::num::NonZeroU32;

    const RATE: RateLimit = RateLimit { per_second: NonZeroU32::MIN, burst: NonZeroU32::MIN };
    const SECRET: &str = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b";
    const STALE: Duration = Duration::from_secs(300);

    /// A file that is deleted, empty or wrong is told once, holds for its time, then shuts the door, and opens it again.
    #[test]
    fn a_wrong_file_of_tokens_is_an_error_and_holds_for_its_time_only() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        let good = format!("phone {SECRET}\n");
        for wrong in
            [None, Some(""), Some("# nobody any more\n"), Some("phone hunter2\n"), Some("\u{0}\u{1}")]
        {
            std::fs::write(&path, &good).expect("written");
            let (file, _) =
                TokensFile::open(&path, RATE, &Clock::default(), STALE).expect("a file of tokens");
            let start = Instant::now();
            assert!(matches!(file.look(start), Look::Same) && !file.is_failing());
            match wrong {
                Some(text) => std::fs::write(&path, text).expect("written"),
                None => std::fs::remove_file(&path).expect("removed"),
            }
            let Look::Refused(error) = file.look(start) else { panic!("{wrong:?} is no error") };
            assert!(
                error.to_string().contains("tokens") && !error.to_string().contains("hunter2"),
                "{error}"
            );
            assert!(file.is_failing());
            assert!(matches!(file.look(start + STALE / 2), Look::Same), "told once, and still open");
            assert!(matches!(file.look(start + STALE), Look::Closed(_)), "{wrong:?}");
            assert!(matches!(file.look(start + 2 * STALE), Look::Same));
            std::fs::write(&path, &good).expect("written");
            assert!(
                matches!(file.look(start + 2 * STALE), Look::Taken(_)) && !file.is_failing(),
                "{wrong:?}"
            );
        }
        // Nobody, and it is meant: at once.
        let (file, _) = TokensFile::open(&path, RATE, &Clock::default(), STALE).expect("a file of tokens");
        std::fs::write(&path, "nobody\n").expect("written");
        assert!(matches!(file.look(Instant::now()), Look::Taken(callers) if callers.is_nobody()));
    }
}
