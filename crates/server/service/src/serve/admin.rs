//! A separate listener for probes and metrics. It still answers when the listeners for queries are overloaded.
//!
//! It speaks plain HTTP and needs no token. So it must be reachable by the operator only: on loopback, or in the
//! network of a cluster. It shows nothing of a query and cannot localize.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;

use crate::http::{ConnectionTimeouts, Listener, serve_connection};
use crate::queue::{Admission, ConnectionLimits, Connections};
use crate::routes::admin_router;
use crate::serve::state::App;

/// Maximum number of open connections. A further connection evicts the one that has been idle longest.
pub(crate) const CONNECTIONS: usize = 64;

/// Maximum lifetime of a connection.
const LIFE: Duration = Duration::from_secs(600);

/// Serves until the future is dropped or `stop` becomes true.
pub(crate) async fn serve(app: Arc<App>, listener: Listener, stop: watch::Receiver<bool>) {
    let connection_timeouts = app.options.timeouts.connection_timeouts();
    serve_router(admin_router(app), connection_timeouts, listener, stop).await;
}

async fn serve_router(
    router: Router,
    connection_timeouts: ConnectionTimeouts,
    listener: Listener,
    mut stop: watch::Receiver<bool>,
) {
    let connections =
        Connections::new(ConnectionLimits { total: CONNECTIONS, per_address: CONNECTIONS, reserved: 0 });
    let connection_timeouts =
        ConnectionTimeouts { unauthenticated_max_age: LIFE, max_age: LIFE, ..connection_timeouts };
    let ending = watch::Sender::new(false);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stop.wait_for(|stop| *stop) => {
                ending.send_replace(true);
                return;
            }
        };
        let Ok((stream, from)) = accepted else {
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        let admission = connections.admit(from);
        let (Admission::Admitted(slot) | Admission::AdmittedByEviction(slot)) = admission else { continue };
        let (service, ending) = (TowerToHyperService::new(router.clone()), ending.subscribe());
        tokio::spawn(async move {
            let (stream, peer) = stream.share();
            serve_connection(stream, peer, service, &slot, connection_timeouts, ending).await;
        });
    }
}
