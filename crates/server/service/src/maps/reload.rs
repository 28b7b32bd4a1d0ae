//! Reloading tokens, certificate and maps while the service runs.
//!
//! A file that cannot be read or used leaves the previous version in force, is reported in the log and the metrics
//! (`veiloc_reload_failing`), and is retried. The last valid tokens stay in force for a limited time only, so that an
//! invalid edit cannot prevent a revocation for ever.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use crate::auth::Timestamp;
use crate::auth::tokens::Callers;
use crate::auth::tokens_file::TokensCheck;
use crate::http::Validity;
use crate::maps::{FolderChange, MapSlot};
use crate::serve::state::App;

impl App {
    /// Checks tokens and certificate: small files on which security depends.
    pub(crate) fn reload_credentials(&self, all: bool, now: Instant) {
        if let Some(file) = &self.tokens {
            match file.check(now) {
                TokensCheck::Unchanged => {}
                TokensCheck::Replaced(callers) => {
                    for (token, change) in callers.changes_since(&self.callers()) {
                        tracing::info!(token, change = change.name(), "token changed");
                    }
                    self.set_callers(callers);
                    self.metrics.reload("tokens", "", true);
                    tracing::info!("tokens replaced");
                }
                TokensCheck::Invalid(error) => {
                    self.metrics.reload("tokens", "", false);
                    let seconds = self.options.tokens_max_stale.as_secs();
                    tracing::error!(%error, "tokens refused; the last valid ones stay in force for {seconds} s");
                }
                TokensCheck::Expired(error) => {
                    self.set_callers(Arc::new(Callers::Closed));
                    self.metrics.reload("tokens", "", false);
                    tracing::error!(%error, "no valid file of tokens for too long: queries are refused until there is one");
                }
            }
            self.metrics.reload_failing("tokens", "", file.is_failing());
        }
        if let Some(tls) = &self.tls {
            if let Some(result) = tls.reload(all, now) {
                self.metrics.reload("certificate", "", result.is_ok());
                match result {
                    Ok(()) => tracing::info!("certificate replaced"),
                    Err(error) => {
                        tracing::error!(%error, "certificate refused; the previous one stays in force");
                    }
                }
            }
            self.metrics.reload_failing("certificate", "", tls.is_failing());
            match tls.validity_warning(Timestamp::of(SystemTime::now()).unix()) {
                Some(Validity::NotYet { seconds }) => tracing::error!(
                    seconds,
                    "the certificate is not valid yet: clients refuse it, or the clock of this machine is behind"
                ),
                Some(Validity::Expired { days }) => tracing::error!(days, "the certificate has expired"),
                Some(Validity::ExpiresSoon { days }) => tracing::warn!(days, "the certificate expires soon"),
                None => {}
            }
            self.metrics.certificate_ends(tls.ends());
        }
    }

    /// Checks the maps: large files, which take longer.
    pub(crate) fn reload_maps(&self, all: bool, now: Instant) {
        match self.maps.scan_folder() {
            Ok(changes) => {
                for change in changes {
                    match change {
                        FolderChange::Added(slot) => {
                            self.metrics.register_map(slot.name());
                            tracing::info!(map = slot.name(), "map found in the folder");
                        }
                        FolderChange::Removed(slot) => {
                            self.metrics.remove_map_gauge(slot.name());
                            tracing::info!(
                                map = slot.name(),
                                "map removed from the folder; it is no longer served"
                            );
                        }
                        FolderChange::Ignored(file) => {
                            tracing::warn!(
                                file,
                                "not served: the file name is not a valid map name, or another map has it"
                            );
                        }
                    }
                }
                self.metrics.reload_failing("folder", "", false);
            }
            Err(error) => {
                self.metrics.reload_failing("folder", "", true);
                tracing::error!(%error, "the folder of maps cannot be read; the served maps do not change");
            }
        }
        for slot in self.maps.slots() {
            self.reload_map(&slot, all, now);
        }
    }

    fn reload_map(&self, slot: &MapSlot, all: bool, now: Instant) {
        let had_one = slot.current().is_some();
        let Some(result) = slot.reload(all, now) else { return };
        self.metrics.reload("map", slot.name(), result.is_ok());
        self.metrics.reload_failing("map", slot.name(), slot.is_failing());
        match result {
            Ok(loaded) => {
                let (images, points) = (loaded.images, loaded.points);
                let what = if had_one { "map replaced" } else { "map opened" };
                tracing::info!(map = slot.name(), images, points, "{what}");
            }
            Err(error) if had_one => {
                tracing::error!(map = slot.name(), %error, "map refused; the previous one is still served");
            }
            Err(error) => {
                tracing::error!(map = slot.name(), %error, "map refused; there is no previous one to serve");
            }
        }
    }
}
