//! Reading files again while the service runs: tokens, certificate, maps.
//!
//! Whatever cannot be read or used leaves what was there before in place, is told in the log and the metrics
//! (`veiloc_reload_failing`), and is tried again. Of tokens the last valid set stays for a limited time only: a
//! revocation that was written wrongly must not be without effect for ever.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use sha2::{Digest as _, Sha256};

use crate::error::ServerError;
use crate::maps::{Change, Slot};
use crate::options::RateLimit;
use crate::state::App;
use crate::tokens::Callers;

/// The file of tokens: its last valid content, and since when it has none.
pub(crate) struct TokensFile {
    path: PathBuf,
    rate: RateLimit,
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
        stale: Duration,
    ) -> Result<(Self, Arc<Callers>), ServerError> {
        let bytes = read(path)?;
        let callers = Arc::new(Callers::parse(&bytes, path, rate, None)?);
        let state = Mutex::new(State { taken: hash(&bytes), callers: callers.clone(), failing: None });
        Ok((Self { path: path.to_owned(), rate, stale, state }, callers))
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
            let callers = Callers::parse(&bytes, &self.path, self.rate, Some(&state.callers))?;
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

/// SHA-256.
pub(crate) fn hash(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

impl App {
    /// Looks at tokens and certificate: small files, and the ones that trust hangs on.
    pub(crate) fn reload_credentials(&self, all: bool, now: Instant) {
        if let Some(file) = &self.tokens {
            match file.look(now) {
                Look::Same => {}
                Look::Taken(callers) => {
                    self.set_callers(callers);
                    self.metrics.reload("tokens", "", true);
                    tracing::info!("tokens replaced");
                }
                Look::Refused(error) => {
                    self.metrics.reload("tokens", "", false);
                    let seconds = self.options.stale_tokens.as_secs();
                    tracing::error!(%error, "tokens refused; the last valid ones hold for {seconds} s");
                }
                Look::Closed(error) => {
                    self.set_callers(Arc::new(Callers::Closed));
                    self.metrics.reload("tokens", "", false);
                    tracing::error!(%error, "no valid file of tokens for too long: nobody may ask until there is one");
                }
            }
            self.metrics.reload_failing("tokens", "", file.is_failing());
        }
        if let Some(tls) = &self.tls {
            if let Some(result) = tls.reload(all, now) {
                self.metrics.reload("certificate", "", result.is_ok());
                match result {
                    Ok(()) => tracing::info!("certificate replaced"),
                    Err(error) => tracing::error!(%error, "certificate refused, the old one stays"),
                }
            }
            self.metrics.reload_failing("certificate", "", tls.is_failing());
        }
    }

    /// Looks at the maps: large files, which may take their time.
    pub(crate) fn reload_maps(&self, all: bool, now: Instant) {
        match self.maps.look_into_folder() {
            Ok(changes) => {
                for change in changes {
                    match change {
                        Change::Added(slot) => tracing::info!(map = slot.name(), "map found in the folder"),
                        Change::Removed(slot) => {
                            self.metrics.forget_map(slot.name());
                            tracing::info!(map = slot.name(), "map taken out of the folder, served no more");
                        }
                        Change::Ignored(file) => {
                            tracing::warn!(file, "not served: its name cannot be a map's, or is another's");
                        }
                    }
                }
                self.metrics.reload_failing("folder", "", false);
            }
            Err(error) => {
                self.metrics.reload_failing("folder", "", true);
                tracing::error!(%error, "the folder of maps cannot be read, maps stay as they are");
            }
        }
        for slot in self.maps.slots() {
            self.reload_map(&slot, all, now);
        }
    }

    fn reload_map(&self, slot: &Slot, all: bool, now: Instant) {
        let had_one = slot.current().is_some();
        let Some(result) = slot.reload(all, now) else { return };
        self.metrics.reload("map", slot.name(), result.is_ok());
        self.metrics.reload_failing("map", slot.name(), slot.is_failing());
        match result {
            Ok(hosted) => {
                let (images, points) = (hosted.map.image_count(), hosted.map.point_count());
                let what = if had_one { "map replaced" } else { "map opened" };
                tracing::info!(map = slot.name(), images, points, "{what}");
            }
            Err(error) if had_one => {
                tracing::error!(map = slot.name(), %error, "map refused, the old one stays");
            }
            Err(error) => {
                tracing::error!(map = slot.name(), %error, "map refused, and there is none to serve")
            }
        }
    }
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
            let (file, _) = TokensFile::open(&path, RATE, STALE).expect("a file of tokens");
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
        let (file, _) = TokensFile::open(&path, RATE, STALE).expect("a file of tokens");
        std::fs::write(&path, "nobody\n").expect("written");
        assert!(matches!(file.look(Instant::now()), Look::Taken(callers) if callers.is_nobody()));
    }
}
