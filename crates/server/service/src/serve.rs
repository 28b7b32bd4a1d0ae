//! Accepting connections, and stopping so that everything that was accepted is answered.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

use axum::Router;
use tokio::sync::watch;

use crate::admin;
use crate::error::ServerError;
use crate::http::{ListenAddress, Listener, Stream, serve_connection};
use crate::options::ServerOptions;
use crate::queue::{Entry, Place};
use crate::routes::router;
use crate::state::App;
use crate::telemetry::ConnectionFault;
use crate::watch::Watchers;
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

/// How far the service has got.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Serving,
    /// It says that it will stop, and still takes connections.
    Leaving,
    /// It takes no connections, and finishes what was accepted.
    Finishing,
    /// Nothing is waited for any more.
    GivingUp,
}

/// How the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped {
    /// Requests that were answered after it had been told to stop.
    pub answered: u64,
    /// Connections that did not end in time.
    pub given_up: usize,
    /// Whether it was told not to wait for them.
    pub forced: bool,
}

/// Where the service listens, and what it serves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listening {
    /// For queries, in the order they were asked for.
    pub addresses: Vec<ListenAddress>,
    /// For probes and metrics, if there is a listener of their own.
    pub admin: Option<SocketAddr>,
    /// Maps that are served at the start.
    pub maps: Vec<String>,
}

impl Listening {
    /// The first TCP address for queries.
    pub fn address(&self) -> Option<SocketAddr> {
        self.addresses.iter().find_map(ListenAddress::tcp)
    }
}

/// Tells a running service what to do.
#[derive(Clone)]
pub struct ServerHandle {
    app: Arc<App>,
    stop: watch::Sender<Phase>,
}

impl ServerHandle {
    /// Stop: first it is said that there will be no more (for [`Timeouts::drain`](crate::Timeouts::drain)), then no new connections are taken;
    /// what was accepted is answered.
    pub fn stop(&self) {
        self.app.close();
        advance(&self.stop, Phase::Leaving);
    }

    /// Stop at once: nothing is waited for.
    pub fn stop_now(&self) {
        self.app.close();
        advance(&self.stop, Phase::GivingUp);
    }

    /// Read maps, tokens and certificate again. Blocks while it reads; what cannot be read is refused with a line in
    /// the log, and what was there before stays.
    pub fn reload(&self) {
        let now = Instant::now();
        self.app.reload_credentials(true, now);
        self.app.reload_maps(true, now);
    }
}

impl Server {
    /// Opens everything and starts to listen; connections wait until [`Self::run`].
    ///
    /// # Errors
    /// [`ServerError`]: options that would be a mistake, a file that cannot be used, an address that is taken.
    pub async fn bind(options: ServerOptions) -> Result<Self, ServerError> {
        let app = Arc::new(App::open(options)?);
        // What there is to say of the certificate is said at the start.
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

    /// The first TCP address where it answers queries.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listening.address()
    }

    /// All addresses it listens on, and the maps it begins with.
    pub const fn listening(&self) -> &Listening {
        &self.listening
    }

    /// For stopping and reloading it while it runs.
    pub fn handle(&self) -> ServerHandle {
        ServerHandle { app: self.app.clone(), stop: self.stop.clone() }
    }

    /// Answers until [`ServerHandle::stop`], then finishes what was accepted, at most for the grace period.
    pub async fn run(self) -> Stopped {
        let Self { app, listeners, admin, stop, _watchers, .. } = self;
        let summing = tokio::spawn(sum_log_lines(app.clone()));
        // Probes and metrics are answered until the very end.
        let end = watch::Sender::new(false);
        let admin = admin.map(|listener| tokio::spawn(admin::serve(app.clone(), listener, end.subscribe())));
        let ending = watch::Sender::new(false);
        let listeners: Vec<Arc<Listener>> = listeners.into_iter().map(Arc::new).collect();
        let mut phase = stop.subscribe();
        tokio::select! {
            () = accept_all(&app, &listeners, &ending) => {}
            () = async {
                wait_for(&mut phase, Phase::Leaving).await;
                tokio::select! {
                    () = tokio::time::sleep(app.options.timeouts.drain) => {}
                    () = wait_for(&mut phase, Phase::Finishing) => {}
                }
            } => {}
        }
        advance(&stop, Phase::Finishing);
        for listener in listeners {
            take_those_waiting(&app, &listener, &ending);
        }
        ending.send_replace(true);
        tokio::select! {
            () = app.connections.all_closed() => {}
            () = tokio::time::sleep(app.options.timeouts.grace) => {}
            () = wait_for(&mut phase, Phase::GivingUp) => {}
        }
        let given_up = app.connections.open();
        let forced = *phase.borrow() == Phase::GivingUp;
        if given_up > 0 {
            // Their requests are dropped with them, which stops the jobs that nobody waits for any more.
            app.connections.close_all();
            let _ = tokio::time::timeout(LAST_MOMENT, app.connections.all_closed()).await;
        }
        summing.abort();
        tell_sums(&app);
        end.send_replace(true);
        if let Some(admin) = admin {
            // It listens to nothing but the word just sent.
            let _ = admin.await;
        }
        let answered = app.answered_since_closing();
        // Joining threads blocks; jobs that were stopped end soon.
        let pool = tokio::task::spawn_blocking(move || {
            app.flush_traces(LAST_MOMENT / 2);
            app.pool.finish();
        });
        let _ = tokio::time::timeout(LAST_MOMENT, pool).await;
        Stopped { answered, given_up, forced }
    }
}

/// How long what was given up may take to end.
const LAST_MOMENT: Duration = Duration::from_secs(1);

/// To a later phase, never back.
fn advance(stop: &watch::Sender<Phase>, to: Phase) {
    stop.send_if_modified(|phase| {
        let later = to > *phase;
        *phase = to.max(*phase);
        later
    });
}

async fn wait_for(phase: &mut watch::Receiver<Phase>, least: Phase) {
    if phase.wait_for(|phase| *phase >= least).await.is_err() {
        // Nobody is left who could say so.
        std::future::pending::<()>().await;
    }
}

/// Takes the connections that came before the end, and waits for no more.
fn take_those_waiting(app: &Arc<App>, listener: &Listener, ending: &watch::Sender<bool>) {
    let router = router(app.clone());
    let mut context = Context::from_waker(Waker::noop());
    while let Poll::Ready(Ok((stream, from))) = listener.poll_accept(&mut context) {
        let may_speak_tls = listener.may_speak_tls();
        if let Some(place) = enter(app, from) {
            let ending = ending.subscribe();
            tokio::spawn(welcome(stream, may_speak_tls, place, app.clone(), router.clone(), ending));
        }
    }
}

/// Takes connections of all listeners until it is dropped.
async fn accept_all(app: &Arc<App>, listeners: &[Arc<Listener>], ending: &watch::Sender<bool>) {
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(app.clone(), listener.clone(), ending.clone()));
    }
    while accepting.join_next().await.is_some() {}
}

/// Takes connections of one listener until it is dropped.
async fn accept(app: Arc<App>, listener: Arc<Listener>, ending: watch::Sender<bool>) {
    let router = router(app.clone());
    let may_speak_tls = listener.may_speak_tls();
    loop {
        match listener.accept().await {
            Ok((stream, from)) => {
                if let Some(place) = enter(&app, from) {
                    let ending = ending.subscribe();
                    tokio::spawn(welcome(stream, may_speak_tls, place, app.clone(), router.clone(), ending));
                }
            }
            // Out of file descriptors, or a client that left at once. Trying again without a pause would spin.
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

/// How often what was left out of the log is summed up.
const SUM_EVERY: Duration = Duration::from_secs(60);

/// What was left out of the log since the last time.
fn tell_sums(app: &App) {
    for ((status, problem), more) in app.quiet.sum() {
        let problem = (!problem.is_empty()).then_some(problem);
        tracing::info!(status, problem, more, "more like these were answered and not logged one by one");
    }
}

async fn sum_log_lines(app: Arc<App>) {
    loop {
        tokio::time::sleep(SUM_EVERY).await;
        tell_sums(&app);
    }
}

/// A place for a new connection, if there is one.
fn enter(app: &App, from: Option<IpAddr>) -> Option<Place> {
    match app.connections.enter(from) {
        Entry::Taken(place) => Some(place),
        Entry::Exchanged(place) => {
            app.metrics.connection_closed("displaced");
            Some(place)
        }
        Entry::Refused => {
            app.metrics.connection_closed("refused");
            None
        }
    }
}

async fn welcome(
    stream: Stream,
    may_speak_tls: bool,
    place: Place,
    app: Arc<App>,
    router: Router,
    ending: watch::Receiver<bool>,
) {
    let conduct = app.options.timeouts.conduct();
    let (stream, peer) = stream.share();
    let service = TowerToHyperService::new(router);
    match app.tls.as_ref().filter(|_| may_speak_tls) {
        None => {
            tell(&app, serve_connection(stream, peer, service, &place, conduct, ending).await);
        }
        Some(tls) => {
            let head = conduct.head;
            let handshake = tokio::time::timeout(head, tls.acceptor().accept(stream));
            // A client that does not get through the handshake is dropped without a word, as TLS would.
            let stream = tokio::select! {
                done = handshake => done,
                () = place.guest().told_to_leave() => return,
                () = place.guest().thrown_out() => return,
            };
            let fault = match stream {
                Ok(Ok(stream)) => serve_connection(stream, peer, service, &place, conduct, ending).await,
                Ok(Err(_)) => Some(ConnectionFault::TlsHandshake),
                Err(_) => Some(ConnectionFault::TlsTimeout),
            };
            tell(&app, fault);
        }
    }
}

/// Counts a connection that did not end well.
fn tell(app: &App, fault: Option<ConnectionFault>) {
    if let Some(fault) = fault {
        app.metrics.connection_fault(fault);
    }
}
