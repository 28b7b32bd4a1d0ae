//! Reading files again while the service runs: tokens, certificate, maps.
//!
//! Whatever cannot be read or used leaves what was there before in place, is told in the log and the metrics
//! (`veiloc_reload_failing`), and is tried again. Of tokens the last valid set stays for a limited time only: a
//! revocation that was written wrongly must not be without effect for ever.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use crate::maps::{Change, Slot};
use crate::state::App;
use crate::tokens::Callers;
use crate::tokens_file::Look;

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
            let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            match tls.days_to_tell(unix.as_secs().cast_signed()) {
                Some(days) if days < 0 => tracing::error!(days = -days, "the certificate has expired"),
                Some(days) => tracing::warn!(days, "the certificate expires soon"),
                None => {}
            }
            self.metrics.certificate_ends(tls.ends());
        }
    }

    /// Looks at the maps: large files, which may take their time.
    pub(crate) fn reload_maps(&self, all: bool, now: Instant) {
        match self.maps.look_into_folder() {
            Ok(changes) => {
                for change in changes {
                    match change {
                        Change::Added(slot) => {
                            self.metrics.map_begins(slot.name());
                            tracing::info!(map = slot.name(), "map found in the folder");
                        }
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
                let (images, points) = (hosted.images, hosted.points);
                let what = if had_one { "map replaced" } else { "map opened" };
                tracing::info!(map = slot.name(), images, points, "{what}");
            }
            Err(error) if had_one => {
                tracing::error!(map = slot.name(), %error, "map refused, the old one stays");
            }
            Err(error) => {
                tracing::error!(map = slot.name(), %error, "map refused, and there is none to serve");
            }
        }
    }
}
