//! A program that is nothing but the service: its threads, and the signals that stop it or make it read files again.

use crate::descriptors;
use crate::error::ServerError;
use crate::options::ServerOptions;
use crate::panics;
use crate::serve::{Listening, Server, ServerHandle, Stopped};

/// What signals tell a running program.
pub trait Told: Clone + Send + Sync + 'static {
    /// Finish what was accepted, then end.
    fn stop(&self);

    /// End at once.
    fn stop_now(&self);

    /// Read files again; may block.
    fn reload(&self);
}

impl Told for ServerHandle {
    fn stop(&self) {
        Self::stop(self);
    }

    fn stop_now(&self) {
        Self::stop_now(self);
    }

    fn reload(&self) {
        Self::reload(self);
    }
}

/// Runs the service until SIGINT or SIGTERM (elsewhere: Ctrl-C) and finishes what was accepted; a second signal ends it at
/// once. SIGHUP makes it read maps, tokens and certificate again.
///
/// `ready` is told the addresses as soon as connections are taken. The process's limit of open files is raised to what the
/// options need, and from here on its panics are told by the log alone.
///
/// # Errors
/// [`ServerError`] when it cannot start.
pub fn run_until_signal(
    options: ServerOptions,
    ready: impl FnOnce(&Listening),
) -> Result<Stopped, ServerError> {
    run_prepared(async { Ok(options) }, ready)
}

/// The same for options that are made within the service's own runtime: those of a gateway, which has connections of its own.
///
/// # Errors
/// What the preparation says, and [`ServerError`] when the service cannot start.
pub fn run_prepared<E: From<ServerError>>(
    prepared: impl Future<Output = Result<ServerOptions, E>>,
    ready: impl FnOnce(&Listening),
) -> Result<Stopped, E> {
    let system = |what| move |source| ServerError::System { what, source };
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().on_thread_start(panics::mark).build();
    let runtime = runtime.map_err(system("a runtime"))?;
    panics::own_process();
    let stopped = runtime.block_on(async {
        let options = prepared.await?;
        descriptors::make_room(&options)?;
        let server = Server::bind(options).await?;
        let stops = Signals::new().map_err(system("signal handlers"))?;
        ready(server.listening());
        let listening = tokio::spawn(stops.obey(server.handle()));
        let stopped = server.run().await;
        listening.abort();
        Ok(stopped)
    });
    // A job that does not end is not waited for.
    runtime.shutdown_background();
    stopped
}

/// SIGINT, SIGTERM and SIGHUP (elsewhere: Ctrl-C), taken from when it is made.
#[cfg(unix)]
pub struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    hang_up: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    /// Takes them.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    /// Tells the program what they say: the first stops it, the second at once.
    pub async fn obey(mut self, server: impl Told) {
        let mut told = false;
        loop {
            tokio::select! {
                _ = self.interrupt.recv() => {}
                _ = self.terminate.recv() => {}
                _ = self.hang_up.recv() => {
                    let server = server.clone();
                    // Not where connections are served; a panic there leaves the old files in place.
                    let _ = tokio::task::spawn_blocking(move || server.reload()).await;
                    continue;
                }
            }
            if told {
                tracing::warn!("told twice: stopping at once");
                return server.stop_now();
            }
            tracing::info!("stopping: finishing what was accepted");
            server.stop();
            told = true;
        }
    }
}

/// Ctrl-C.
#[cfg(not(unix))]
pub struct Signals;

#[cfg(not(unix))]
impl Signals {
    /// Takes it.
    ///
    /// # Errors
    /// None.
    pub fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    /// Tells the program what it says: the first stops it, the second at once.
    pub async fn obey(self, server: impl Told) {
        // Without a handler for Ctrl-C the system ends the program, which is all there is left to do.
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop();
        }
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop_now();
        }
    }
}
