//! Accepting connections, and stopping so that everything that was accepted is answered.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

use crate::admin;
use crate::connection::{Conduct, serve_connection};
use crate::connections::{Entry, Place};
use crate::error::ServerError;
use crate::options::{ServerOptions, Timeouts};
use crate::routes::router;
use crate::state::App;
use crate::watch::Watchers;

/// The service, bound to its address, with all maps open.
pub struct Server {
    app: Arc<App>,
    listener: TcpListener,
    listening: Listening,
    admin: Option<TcpListener>,
    _watchers: Option<Watchers>,
    stop: watch::Sender<bool>,
}

/// Where the service listens, and what it serves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listening {
    /// For queries.
    pub address: SocketAddr,
    /// For probes and metrics, if there is a listener of their own.
    pub admin: Option<SocketAddr>,
    /// Maps that are served at the start.
    pub maps: Vec<String>,
}

/// Tells a running service what to do.
#[derive(Clone)]
pub struct ServerHandle {
    app: Arc<App>,
    stop: watch::Sender<bool>,
}

impl ServerHandle {
    /// Stop: no new connections; what was accepted is answered.
    pub fn stop(&self) {
        self.app.close();
        self.stop.send_replace(true);
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
        let (listener, address) = bind(app.options.listen).await?;
        let admin = match app.options.admin {
            Some(admin) => Some(bind(admin).await?),
            None => None,
        };
        let (admin, admin_address) = admin.unzip();
        let served = app.maps.slots().into_iter().filter(|slot| slot.current().is_some());
        let maps = served.map(|slot| slot.name().to_owned()).collect();
        let listening = Listening { address, admin: admin_address, maps };
        let system = |source| ServerError::System { what: "threads", source };
        let watchers =
            app.options.watch.map(|every| Watchers::start(&app, every)).transpose().map_err(system)?;
        Ok(Self { app, listener, listening, admin, _watchers: watchers, stop: watch::Sender::new(false) })
    }

    /// Where it answers queries.
    pub const fn address(&self) -> SocketAddr {
        self.listening.address
    }

    /// All addresses it listens on, and the maps it begins with.
    pub const fn listening(&self) -> &Listening {
        &self.listening
    }

    /// For stopping and reloading it while it runs.
    pub fn handle(&self) -> ServerHandle {
        ServerHandle { app: self.app.clone(), stop: self.stop.clone() }
    }

    /// Answers until [`ServerHandle::stop`], then finishes what was accepted, at most for the grace period. Returns
    /// how many connections had to be given up.
    pub async fn run(self) -> usize {
        let Self { app, listener, admin, stop, _watchers, .. } = self;
        let summing = tokio::spawn(sum_log_lines(app.clone()));
        // Probes and metrics are answered until the very end.
        let end = watch::Sender::new(false);
        let admin = admin.map(|listener| tokio::spawn(admin::serve(app.clone(), listener, end.subscribe())));
        let router = router(app.clone());
        let mut stopped = stop.subscribe();
        loop {
            let accepted = tokio::select! {
                accepted = listener.accept() => accepted,
                _ = stopped.wait_for(|stop| *stop) => break,
            };
            match accepted {
                Ok((stream, from)) => {
                    if let Some(place) = enter(&app, from.ip()) {
                        tokio::spawn(welcome(stream, place, app.clone(), router.clone(), stop.subscribe()));
                    }
                }
                // Out of file descriptors, or a client that left at once. Trying again without a pause would spin.
                Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
            }
        }
        drop(listener);
        let in_time =
            tokio::time::timeout(app.options.timeouts.grace, app.connections.all_closed()).await.is_ok();
        let abandoned = if in_time { 0 } else { app.connections.open() };
        summing.abort();
        app.quiet.tell();
        end.send_replace(true);
        if let Some(admin) = admin {
            // It listens to nothing but the word just sent.
            let _ = admin.await;
        }
        // Joining threads blocks.
        let _ = tokio::task::spawn_blocking(move || app.pool.finish()).await;
        abandoned
    }
}

async fn bind(listen: SocketAddr) -> Result<(TcpListener, SocketAddr), ServerError> {
    let wrong = |source| ServerError::Listen { listen, source };
    let listener = TcpListener::bind(listen).await.map_err(wrong)?;
    let address = listener.local_addr().map_err(wrong)?;
    Ok((listener, address))
}

/// How often what was left out of the log is summed up.
const SUM_EVERY: Duration = Duration::from_secs(60);

async fn sum_log_lines(app: Arc<App>) {
    loop {
        tokio::time::sleep(SUM_EVERY).await;
        app.quiet.tell();
    }
}

/// A place for a new connection, if there is one.
fn enter(app: &App, from: IpAddr) -> Option<Place> {
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
    stream: TcpStream,
    place: Place,
    app: Arc<App>,
    router: Router,
    stop: watch::Receiver<bool>,
) {
    // Answers are small: waiting to fill a packet only delays them. Not worth refusing a connection over.
    let _ = stream.set_nodelay(true);
    let Timeouts { head, write, unknown_life, life, .. } = app.options.timeouts;
    let conduct = Conduct { head, write, unknown_life, life };
    match &app.tls {
        None => serve_connection(stream, router, &place, conduct, stop).await,
        Some(tls) => {
            let handshake = tokio::time::timeout(head, tls.acceptor().accept(stream));
            // A client that does not get through the handshake is dropped without a word, as TLS would.
            let stream = tokio::select! {
                done = handshake => done,
                () = place.guest().told_to_leave() => return,
            };
            if let Ok(Ok(stream)) = stream {
                serve_connection(stream, router, &place, conduct, stop).await;
            }
        }
    }
}
