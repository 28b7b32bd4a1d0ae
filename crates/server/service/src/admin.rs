//! A listener of its own for probes and metrics: whatever happens where queries come in, the operator is answered.
//!
//! It speaks plain HTTP and asks for no token, so it belongs where only the operator reaches it: loopback, or the
//! network of a cluster. There is nothing of a query on it, and no way to localize.

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
use crate::http::{Conduct, ListenAddress, Listener, serve_connection};
use crate::options::Timeouts;
use crate::problem::Problem;
use crate::queue::{Connections, Entry, Limits};
use crate::routes::{METRICS_TYPE, admin_router};
use crate::state::App;

/// Connections at a time; one more takes the place of the one that is idle for longest.
pub(crate) const CONNECTIONS: usize = 64;

/// Longest a connection stays open.
const LIFE: Duration = Duration::from_secs(600);

/// Answers until it is dropped or `stop` says so.
pub(crate) async fn serve(app: Arc<App>, listener: Listener, stop: watch::Receiver<bool>) {
    let conduct = app.options.timeouts.conduct();
    serve_router(admin_router(app), conduct, listener, stop).await;
}

/// What probes and a scrape ask a program that answers no queries over HTTP.
pub trait Probed: Send + Sync {
    /// Whether it does its work, or why it does not.
    ///
    /// # Errors
    /// Why not, in a word or two.
    fn ready(&self) -> Result<(), String>;

    /// Counts and times in the text format of Prometheus.
    fn metrics(&self) -> String;
}

/// Answers `/healthz`, `/readyz` and `/metrics` of a program that answers no queries over HTTP, until `stop` says so; tells
/// first where it listens.
///
/// # Errors
/// [`ServerError::Listen`]: the address is taken or not ours.
pub async fn probes(
    probed: Arc<dyn Probed>,
    address: SocketAddr,
    stop: watch::Receiver<bool>,
) -> Result<(SocketAddr, impl Future<Output = ()> + Send), ServerError> {
    let listen = ListenAddress::Tcp(address);
    let wrong = |source| ServerError::Listen { listen: listen.clone(), source };
    let listener = Listener::bind(&listen, 0).await.map_err(wrong)?;
    let told = listener.address().map_err(|error| wrong(error.into()))?;
    let router = Router::new()
        .route("/healthz", get(async || "alive\n"))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
        .method_not_allowed_fallback(async || Problem::WrongMethod)
        .fallback(async || Problem::NotFound)
        .with_state(probed);
    let answering = serve_router(router, Timeouts::default().conduct(), listener, stop);
    Ok((told.tcp().unwrap_or(address), answering))
}

async fn ready(State(probed): State<Arc<dyn Probed>>) -> (StatusCode, String) {
    match probed.ready() {
        Ok(()) => (StatusCode::OK, "ready\n".to_owned()),
        Err(why) => (StatusCode::SERVICE_UNAVAILABLE, why + "\n"),
    }
}

async fn metrics(State(probed): State<Arc<dyn Probed>>) -> Response {
    ([(CONTENT_TYPE, METRICS_TYPE)], probed.metrics()).into_response()
}

async fn serve_router(router: Router, conduct: Conduct, listener: Listener, mut stop: watch::Receiver<bool>) {
    let connections = Connections::new(Limits { total: CONNECTIONS, per_address: CONNECTIONS, reserved: 0 });
    let conduct = Conduct { unknown_life: LIFE, life: LIFE, ..conduct };
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
        let entry = connections.enter(from);
        let (Entry::Taken(place) | Entry::Exchanged(place)) = entry else { continue };
        let (service, ending) = (TowerToHyperService::new(router.clone()), ending.subscribe());
        tokio::spawn(async move {
            let (stream, peer) = stream.share();
            serve_connection(stream, peer, service, &place, conduct, ending).await;
        });
    }
}
