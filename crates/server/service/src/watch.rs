//! Looks at intervals whether files were replaced, on threads of its own: no work of the service can keep them waiting.
//!
//! Tokens and certificate have their own thread, because a revocation must not wait for a large map to be read. Asking
//! the file system every two seconds works everywhere, on network drives too, and needs no library; notifications of the
//! system do not.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use crate::panics;
use crate::state::App;

/// The threads; they end when this is dropped, each when it has finished the file it reads.
pub(crate) struct Watchers {
    _until_dropped: Vec<Sender<()>>,
}

impl Watchers {
    /// Starts them.
    pub(crate) fn start(app: &Arc<App>, every: Duration) -> io::Result<Self> {
        let credentials =
            start("watch-credentials", app, every, |app| app.reload_credentials(false, Instant::now()))?;
        let maps = start("watch-maps", app, every, |app| app.reload_maps(false, Instant::now()))?;
        Ok(Self { _until_dropped: vec![credentials, maps] })
    }
}

fn start(name: &str, app: &Arc<App>, every: Duration, look: fn(&App)) -> io::Result<Sender<()>> {
    let (alive, dropped) = channel();
    let app = Arc::downgrade(app);
    let run = move || {
        panics::mark();
        while dropped.recv_timeout(every) == Err(RecvTimeoutError::Timeout) {
            let Some(app) = app.upgrade() else { return };
            if catch_unwind(AssertUnwindSafe(|| look(&app))).is_err() {
                tracing::error!("reading files again broke; the old ones stay");
            }
        }
    };
    std::thread::Builder::new().name(name.to_owned()).spawn(run)?;
    Ok(alive)
}
