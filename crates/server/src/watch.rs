//! Looks at intervals whether files were replaced.
//!
//! Asking the file system for five numbers every two seconds works everywhere, on network drives too, and needs no
//! library; notifications of the system do not.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::state::App;

/// Runs until `stop` says so.
pub(crate) async fn watch_files(app: Arc<App>, every: Duration, mut stop: watch::Receiver<bool>) {
    loop {
        tokio::select! {
            () = tokio::time::sleep(every) => {}
            _ = stop.wait_for(|stop| *stop) => return,
        }
        let app = app.clone();
        // Opening a map reads all of it: not where connections are served.
        if tokio::task::spawn_blocking(move || app.reload(false)).await.is_err() {
            tracing::error!("reading files again broke; the old ones stay");
        }
    }
}
