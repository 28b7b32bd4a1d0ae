//! Polls files for changes on threads of its own, so that no other work can delay it.
//!
//! Tokens and certificate have a thread of their own, because a revocation must not wait until a large map is read.
//! Polling every two seconds works on every file system, network drives included, and needs no library; notifications
//! of the system do not work everywhere.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use crate::serve::state::App;
use crate::telemetry::panics;

/// The polling threads; they end after this is dropped, each when it has finished the file it reads.
pub(crate) struct Watchers {
    _until_dropped: Vec<Sender<()>>,
}

impl Watchers {
    /// Starts the threads.
    pub(crate) fn start(app: &Arc<App>, every: Duration) -> io::Result<Self> {
        let credentials =
            start(Watched::Credentials, app, every, |app| app.reload_credentials(false, Instant::now()))?;
        let maps = start(Watched::Maps, app, every, |app| app.reload_maps(false, Instant::now()))?;
        Ok(Self { _until_dropped: vec![credentials, maps] })
    }
}

/// What a thread checks.
#[derive(Debug, Clone, Copy)]
enum Watched {
    Credentials,
    Maps,
}

impl Watched {
    const fn name(self) -> &'static str {
        match self {
            Self::Credentials => "credentials",
            Self::Maps => "maps",
        }
    }
}

fn start(watched: Watched, app: &Arc<App>, every: Duration, check: fn(&App)) -> io::Result<Sender<()>> {
    let (alive, dropped) = channel();
    // From the start, so that a first check that does not end is seen too.
    app.metrics.files_checked(watched.name());
    let app = Arc::downgrade(app);
    let run = move || {
        panics::mark_service_thread();
        while dropped.recv_timeout(every) == Err(RecvTimeoutError::Timeout) {
            let Some(app) = app.upgrade() else { return };
            if catch_unwind(AssertUnwindSafe(|| check(&app))).is_err() {
                tracing::error!("reloading files failed with a panic; the previous versions stay in force");
            }
            app.metrics.files_checked(watched.name());
        }
    };
    std::thread::Builder::new().name(format!("watch-{}", watched.name())).spawn(run)?;
    Ok(alive)
}
