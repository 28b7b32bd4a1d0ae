//! Accepts connections, and shuts down so that every accepted request is answered.

pub(crate) mod admin;
pub(crate) mod open_files;
pub(crate) mod signals;
pub(crate) mod state;

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use tokio::sync::watch;

use crate::error::ServerError;
use crate::http::{ListenAddress, Listener, Stream, serve_connection};
use crate::maps::watch::Watchers;
use crate::options::ServerOptions;
use crate::queue::{Admission, Slot};
use crate::routes::router;
use crate::serve::state::App;
use crate::telemetry::ConnectionFault;
use hyper_util::service::TowerToHyperService;
use tokio::task::JoinSet;

/// The service, bound to its addresses, with all maps open.
pub struct Server {
    app: Arc<App>,
    listeners: Vec<Listener>,
    listening: Listening,
    admin: Option<Listener>,
    _watchers: Option<Watchers>,
    stop: watch::Sender<Phase>,
}

/// Phases of the life of the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Serving,
    /// Announces the shutdown and still accepts connections.
    Draining,
    /// Accepts no connections and finishes accepted requests.
    Finishing,
    /// Closes everything at once.
    Aborting,
}

/// How the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShutdownSummary {
    /// Requests answered after the stop request.
    pub answered: u64,
    /// Connections that did not end in time and were closed.
    pub given_up: usize,
    /// Whether an immediate stop was requested.
    pub forced: bool,
}

/// Bound addresses, and the maps that are served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listening {
    /// Addresses for queries, in configured order.
    pub addresses: Vec<ListenAddress>,
    /// Address for probes and metrics, if configured.
    pub admin: Option<SocketAddr>,
    /// Names of the maps that could be opened.
    pub maps: Vec<String>,
}

impl Listening {
    /// The first TCP address for queries.
    pub fn address(&self) -> Option<SocketAddr> {
        self.addresses.iter().find_map(ListenAddress::tcp)
    }
}

/// Controls a running service.
#[derive(Clone)]
pub struct ServerHandle {
    app: Arc<App>,
    stop: watch::Sender<Phase>,
}

impl ServerHandle {
    /// Shuts down: announces the shutdown for [`Timeouts::drain`](crate::Timeouts::drain), then closes the listeners
    /// and answers accepted requests.
    pub fn stop(&self) {
        self.app.close();
        advance(&self.stop, Phase::Draining);
    }

    /// Stops at once and closes all connections.
    pub fn stop_now(&self) {
        self.app.close();
        advance(&self.stop, Phase::Aborting);
    }

    /// Reloads maps, tokens and certificate; blocks while reading. A file that cannot be read is logged, and its
    /// previous version stays in force.
    pub fn reload(&self) {
        let now = Instant::now();
        self.app.reload_credentials(true, now);
        self.app.reload_maps(true, now);
    }
}

impl Server {
    /// Opens all files and binds all addresses; connections wait until [`Self::run`].
    ///
    /// # Errors
    /// [`ServerError`]: invalid options, a file that cannot be used, or an address in use.
    pub async fn bind(options: ServerOptions) -> Result<Self, ServerError> {
        let app = Arc::new(App::open(options)?);
        // Reports an expiring certificate at the start.
        app.reload_credentials(false, Instant::now());
        let (mut listeners, mut addresses) = (Vec::new(), Vec::new());
        for listen in &app.options.listen {
            let (listener, address) = bind(listen, app.options.socket_mode).await?;
            listeners.push(listener);
            addresses.push(address);
        }
        let admin = match app.options.admin {
            Some(admin) => Some(bind(&ListenAddress::Tcp(admin), 0).await?),
            None => None,
        };
        let (admin, admin_address) = admin.unzip();
        let admin_address = admin_address.and_then(|address| address.tcp());
        let served = app.maps.slots().into_iter().filter(|slot| slot.current().is_some());
        let maps = served.map(|slot| slot.name().to_owned()).collect();
        let listening = Listening { addresses, admin: admin_address, maps };
        let system = |source| ServerError::System { what: "threads", source };
        let watchers =
            app.options.watch.map(|every| Watchers::start(&app, every)).transpose().map_err(system)?;
        Ok(Self {
            app,
            listeners,
            listening,
            admin,
            _watchers: watchers,
            stop: watch::Sender::new(Phase::Serving),
        })
    }

    /// The first TCP address for queries.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listening.address()
    }

    /// All bound addresses, and the maps that could be opened.
    pub const fn listening(&self) -> &Listening {
        &self.listening
    }

    /// A handle for stopping and reloading the running service.
    pub fn handle(&self) -> ServerHandle {
        ServerHandle { app: self.app.clone(), stop: self.stop.clone() }
    }

    /// Serves until [`ServerHandle::stop`], then finishes accepted requests within the grace period.
    pub async fn run(self) -> ShutdownSummary {
        let Self { app, listeners, admin, stop, _watchers, .. } = self;
        let summing = tokio::spawn(log_suppressed_periodically(app.clone()));
        // Probes and metrics are answered until the end.
        let end = watch::Sender::new(false);
        let admin = admin.map(|listener| tokio::spawn(admin::serve(app.clone(), listener, end.subscribe())));
        let ending = watch::Sender::new(false);
        let listeners: Vec<Arc<Listener>> = listeners.into_iter().map(Arc::new).collect();
        let mut phase = stop.subscribe();
        let mut accepting = JoinSet::new();
        for listener in &listeners {
            accepting.spawn(accept(app.clone(), listener.clone(), ending.clone()));
        }
        wait_for(&mut phase, Phase::Draining).await;
        tokio::select! {
            () = tokio::time::sleep(app.options.timeouts.drain) => {}
            () = wait_for(&mut phase, Phase::Finishing) => {}
        }
        advance(&stop, Phase::Finishing);
        // An aborted task that is not awaited keeps its listener open for a moment: the system would accept
        // connections in that moment, and they would be lost.
        accepting.shutdown().await;
        for listener in listeners {
            let listener = Arc::into_inner(listener).expect("the task that shared it has ended");
            accept_pending_and_close(&app, listener, &ending);
        }
        ending.send_replace(true);
        tokio::select! {
            () = app.connections.all_closed() => {}
            () = tokio::time::sleep(app.options.timeouts.grace) => {}
            () = wait_for(&mut phase, Phase::Aborting) => {}
        }
        let given_up = app.connections.open();
        let forced = *phase.borrow() == Phase::Aborting;
        if given_up > 0 {
            // Closing a connection drops its requests, which cancels their jobs.
            app.connections.close_all();
            let _ = tokio::time::timeout(ABORT_TIMEOUT, app.connections.all_closed()).await;
        }
        summing.abort();
        log_suppressed(&app);
        end.send_replace(true);
        if let Some(admin) = admin {
            // It ends only by the message just sent.
            let _ = admin.await;
        }
        let answered = app.answered_since_closing();
        // Joining threads blocks; cancelled jobs end soon.
        let pool = tokio::task::spawn_blocking(move || {
            app.flush_traces(ABORT_TIMEOUT / 2);
            app.pool.finish();
        });
        let _ = tokio::time::timeout(ABORT_TIMEOUT, pool).await;
        ShutdownSummary { answered, given_up, forced }
    }
}

/// Time limit for closing aborted connections.
const ABORT_TIMEOUT: Duration = Duration::from_secs(1);

/// Moves to a later phase, never to an earlier one.
fn advance(stop: &watch::Sender<Phase>, to: Phase) {
    stop.send_if_modified(|phase| {
        let later = to > *phase;
        *phase = to.max(*phase);
        later
    });
}

async fn wait_for(phase: &mut watch::Receiver<Phase>, target: Phase) {
    if phase.wait_for(|phase| *phase >= target).await.is_err() {
        // The sender is gone, so the phase cannot change any more.
        std::future::pending::<()>().await;
    }
}

/// Accepts the connections that are already pending, without waiting for more, and closes the listener.
fn accept_pending_and_close(app: &Arc<App>, listener: Listener, ending: &watch::Sender<bool>) {
    let router = router(app.clone());
    let may_speak_tls = listener.may_speak_tls();
    while let Some((stream, from)) = listener.accept_pending() {
        if let Some(slot) = admit(app, from) {
            let ending = ending.subscribe();
            tokio::spawn(serve_stream(stream, may_speak_tls, slot, app.clone(), router.clone(), ending));
        }
    }
}

/// Accepts connections of one listener until the future is dropped.
async fn accept(app: Arc<App>, listener: Arc<Listener>, ending: watch::Sender<bool>) {
    let router = router(app.clone());
    let may_speak_tls = listener.may_speak_tls();
    loop {
        match listener.accept().await {
            Ok((stream, from)) => {
                if let Some(slot) = admit(&app, from) {
                    let ending = ending.subscribe();
                    tokio::spawn(serve_stream(
                        stream,
                        may_speak_tls,
                        slot,
                        app.clone(),
                        router.clone(),
                        ending,
                    ));
                }
            }
            // Out of file descriptors, or the client is gone already. The pause keeps the loop from spinning.
            Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
        }
    }
}

async fn bind(listen: &ListenAddress, mode: u32) -> Result<(Listener, ListenAddress), ServerError> {
    let wrong = |source| ServerError::Listen { listen: listen.clone(), source };
    let listener = Listener::bind(listen, mode).await.map_err(wrong)?;
    let address = listener.address().map_err(|error| wrong(error.into()))?;
    Ok((listener, address))
}

/// Interval of the reports of suppressed log lines.
const SUM_EVERY: Duration = Duration::from_secs(60);

/// Logs the number of suppressed lines since the last report.
fn log_suppressed(app: &App) {
    for ((status, problem), more) in app.log_throttle.take_suppressed() {
        let problem = (!problem.is_empty()).then_some(problem);
        tracing::info!(
            status,
            problem,
            more,
            "more requests with this status were answered; their log lines were suppressed"
        );
    }
}

async fn log_suppressed_periodically(app: Arc<App>) {
    loop {
        tokio::time::sleep(SUM_EVERY).await;
        log_suppressed(&app);
    }
}

/// Admits a new connection, if possible.
fn admit(app: &App, from: Option<IpAddr>) -> Option<Slot> {
    match app.connections.admit(from) {
        Admission::Admitted(slot) => Some(slot),
        Admission::AdmittedByEviction(slot) => {
            app.metrics.connection_closed("evicted");
            Some(slot)
        }
        Admission::Rejected => {
            app.metrics.connection_closed("refused");
            None
        }
    }
}

async fn serve_stream(
    stream: Stream,
    may_speak_tls: bool,
    slot: Slot,
    app: Arc<App>,
    router: Router,
    ending: watch::Receiver<bool>,
) {
    let connection_timeouts = app.options.timeouts.connection_timeouts();
    let (stream, peer) = stream.share();
    let service = TowerToHyperService::new(router);
    match app.tls.as_ref().filter(|_| may_speak_tls) {
        None => {
            count_fault(
                &app,
                serve_connection(stream, peer, service, &slot, connection_timeouts, ending).await,
            );
        }
        Some(tls) => {
            let head = connection_timeouts.head;
            let handshake = tokio::time::timeout(head, tls.acceptor().accept(stream));
            // A client that fails the handshake is dropped without a message, as TLS does.
            let stream = tokio::select! {
                done = handshake => done,
                () = slot.connection().evicted() => return,
                () = slot.connection().force_closed() => return,
            };
            let fault = match stream {
                Ok(Ok(stream)) => {
                    serve_connection(stream, peer, service, &slot, connection_timeouts, ending).await
                }
                Ok(Err(_)) => Some(ConnectionFault::TlsHandshake),
                Err(_) => Some(ConnectionFault::TlsTimeout),
            };
            count_fault(&app, fault);
        }
    }
}

/// Counts the fault of a connection, if it had one.
fn count_fault(app: &App, fault: Option<ConnectionFault>) {
    if let Some(fault) = fault {
        app.metrics.connection_fault(fault);
    }
}
