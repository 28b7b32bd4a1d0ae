//! Accepting connections, and stopping so that everything that was accepted is answered.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::connection::serve_connection;
use crate::error::ServerError;
use crate::options::ServerOptions;
use crate::routes::router;
use crate::state::App;
use crate::watch::watch_files;

/// The service, bound to its address, with all maps open.
pub struct Server {
    app: Arc<App>,
    listener: TcpListener,
    address: SocketAddr,
    stop: watch::Sender<bool>,
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
        self.app.reload(true);
    }
}

impl Server {
    /// Opens everything and starts to listen; connections wait until [`Self::run`].
    ///
    /// # Errors
    /// [`ServerError`]: options that would be a mistake, a file that cannot be used, an address that is taken.
    pub async fn bind(options: ServerOptions) -> Result<Self, ServerError> {
        let listen = options.listen;
        let app = Arc::new(App::open(options)?);
        let wrong = |source| ServerError::Listen { listen, source };
        let listener = TcpListener::bind(listen).await.map_err(wrong)?;
        let address = listener.local_addr().map_err(wrong)?;
        Ok(Self { app, listener, address, stop: watch::Sender::new(false) })
    }

    /// Where it listens.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// For stopping and reloading it while it runs.
    pub fn handle(&self) -> ServerHandle {
        ServerHandle { app: self.app.clone(), stop: self.stop.clone() }
    }

    /// Answers until [`ServerHandle::stop`], then finishes what was accepted, at most for the grace period. Returns
    /// how many connections had to be given up.
    pub async fn run(self) -> usize {
        let Self { app, listener, stop, .. } = self;
        let watcher =
            app.options.watch.map(|every| tokio::spawn(watch_files(app.clone(), every, stop.subscribe())));
        let router = router(app.clone());
        let connections = app.options.connections.get();
        let slots = Arc::new(Semaphore::new(connections));
        let mut stopped = stop.subscribe();
        loop {
            let accept = async {
                // A slot first: what cannot be served yet stays in the system's backlog.
                let slot = slots.clone().acquire_owned().await.ok()?;
                Some((slot, listener.accept().await))
            };
            let accepted = tokio::select! {
                accepted = accept => accepted,
                _ = stopped.wait_for(|stop| *stop) => break,
            };
            match accepted {
                Some((slot, Ok((stream, _)))) => {
                    tokio::spawn(welcome(stream, slot, app.clone(), router.clone(), stop.subscribe()));
                }
                // Out of file descriptors, or a client that left at once. Trying again without a pause would spin.
                Some((_, Err(_))) => tokio::time::sleep(Duration::from_millis(10)).await,
                None => break,
            }
        }
        drop(listener);
        // All slots free means all connections closed.
        let all = slots.acquire_many(u32::try_from(connections).unwrap_or(u32::MAX));
        let in_time = tokio::time::timeout(app.options.timeouts.grace, all).await.is_ok();
        let abandoned = if in_time { 0 } else { connections - slots.available_permits() };
        if let Some(watcher) = watcher {
            // It ends by itself; a map it is reading may take a while, and nobody needs it any more.
            watcher.abort();
        }
        // Joining threads blocks.
        let _ = tokio::task::spawn_blocking(move || app.pool.finish()).await;
        abandoned
    }
}

async fn welcome(
    stream: TcpStream,
    slot: OwnedSemaphorePermit,
    app: Arc<App>,
    router: Router,
    stop: watch::Receiver<bool>,
) {
    let gauge = &app.metrics.connections;
    gauge.inc();
    // Answers are small: waiting to fill a packet only delays them. Not worth refusing a connection over.
    let _ = stream.set_nodelay(true);
    let (head, write) = (app.options.timeouts.head, app.options.timeouts.write);
    match &app.tls {
        None => serve_connection(stream, router, head, write, stop).await,
        Some(tls) => {
            // A client that does not get through the handshake is dropped without a word, as TLS would.
            if let Ok(Ok(stream)) = tokio::time::timeout(head, tls.acceptor().accept(stream)).await {
                serve_connection(stream, router, head, write, stop).await;
            }
        }
    }
    gauge.dec();
    drop(slot);
}
