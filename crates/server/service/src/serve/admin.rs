//! A separate listener for probes and metrics. It still answers when the listeners for queries are overloaded.
//!
//! It speaks plain HTTP and needs no token. So it must be reachable by the operator only: on loopback, or in the
//! network of a cluster. It shows nothing of a query and cannot localize.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;

use crate::error::ServerError;
use crate::http::problem::Problem;
use crate::http::{ConnectionTimeouts, ListenAddress, Listener, serve_connection};
use crate::options::Timeouts;
use crate::queue::{Admission, ConnectionLimits, Connections};
use crate::routes::{METRICS_TYPE, admin_router};
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

/// State that a program without an HTTP interface for queries (a worker) exposes to probes and to Prometheus.
pub trait HealthProbe: Send + Sync {
    /// Readiness; on failure the reason.
    ///
    /// # Errors
    /// The reason, in a word or two.
    fn ready(&self) -> Result<(), String>;

    /// Metrics in the text format of Prometheus.
    fn metrics(&self) -> String;
}

/// Binds `address` and returns the bound address and a future that answers `/healthz`, `/readyz` and `/metrics` until
/// `stop` becomes true.
///
/// # Errors
/// [`ServerError::Listen`]: the address is in use or does not belong to this machine.
pub async fn probes(
    probe: Arc<dyn HealthProbe>,
    address: SocketAddr,
    stop: watch::Receiver<bool>,
) -> Result<(SocketAddr, impl Future<Output = ()> + Send), ServerError> {
    let listen = ListenAddress::Tcp(address);
    let wrong = |source| ServerError::Listen { listen: listen.clone(), source };
    let listener = Listener::bind(&listen, 0).await.map_err(wrong)?;
    let bound = listener.address().map_err(|error| wrong(error.into()))?;
    let router = Router::new()
        .route("/healthz", get(async || "alive\n"))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
        .method_not_allowed_fallback(async || Problem::WrongMethod)
        .fallback(async || Problem::NotFound)
        .with_state(probe);
    let serving = serve_router(router, Timeouts::default().connection_timeouts(), listener, stop);
    Ok((bound.tcp().unwrap_or(address), serving))
}

async fn ready(State(probe): State<Arc<dyn HealthProbe>>) -> (StatusCode, String) {
    match probe.ready() {
        Ok(()) => (StatusCode::OK, "ready\n".to_owned()),
        Err(why) => (StatusCode::SERVICE_UNAVAILABLE, why + "\n"),
    }
}

async fn metrics(State(probe): State<Arc<dyn HealthProbe>>) -> Response {
    ([(CONTENT_TYPE, METRICS_TYPE)], probe.metrics()).into_response()
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
