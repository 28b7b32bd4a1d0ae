//! Runs the service as a program: runtime, and signals that stop or reload it.

use crate::error::ServerError;
use crate::options::ServerOptions;
use crate::serve::open_files;
use crate::serve::{Listening, Server, ServerHandle, ShutdownSummary};
use crate::telemetry::panics;

/// Runs the service until SIGINT or SIGTERM (on other systems: Ctrl-C) and finishes accepted requests; a second
/// signal ends it at once. SIGHUP reloads maps, tokens and certificate.
///
/// `ready` is called with the addresses once connections are accepted. The limit of open files of the process is
/// raised to what the options need, and from here on its panics are reported only in the log.
///
/// # Errors
/// [`ServerError`]: the service cannot start.
pub fn run_until_signal(
    options: ServerOptions,
    ready: impl FnOnce(&Listening),
) -> Result<ShutdownSummary, ServerError> {
    run_prepared(async { Ok(options) }, ready)
}

/// As [`run_until_signal`], for options that must be created within the runtime of the service: those of a gateway,
/// which has connections of its own.
///
/// # Errors
/// The error of the preparation, or [`ServerError`]: the service cannot start.
pub fn run_prepared<E: From<ServerError>>(
    prepared: impl Future<Output = Result<ServerOptions, E>>,
    ready: impl FnOnce(&Listening),
) -> Result<ShutdownSummary, E> {
    let system = |what| move |source| ServerError::System { what, source };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .on_thread_start(panics::mark_service_thread)
        .build();
    let runtime = runtime.map_err(system("a runtime"))?;
    panics::hide_panic_messages();
    let stopped = runtime.block_on(async {
        let options = prepared.await?;
        open_files::raise_limit(&options)?;
        let server = Server::bind(options).await?;
        let stops = Signals::new().map_err(system("signal handlers"))?;
        ready(server.listening());
        let listening = tokio::spawn(stops.handle_signals(server.handle()));
        let stopped = server.run().await;
        listening.abort();
        Ok(stopped)
    });
    // Do not wait for a job that does not end.
    runtime.shutdown_background();
    stopped
}

/// Handlers of SIGINT, SIGTERM and SIGHUP (on other systems: Ctrl-C), installed on creation.
#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    hang_up: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    /// Installs the handlers.
    ///
    /// # Errors
    /// The system refused a handler.
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    /// Forwards the signals: the first stops the program gracefully, the second at once.
    async fn handle_signals(mut self, server: ServerHandle) {
        let mut is_stopping = false;
        loop {
            tokio::select! {
                _ = self.interrupt.recv() => {}
                _ = self.terminate.recv() => {}
                _ = self.hang_up.recv() => {
                    let server = server.clone();
                    // Not on a thread that serves connections; a panic there leaves the previous files in force.
                    let _ = tokio::task::spawn_blocking(move || server.reload()).await;
                    continue;
                }
            }
            if is_stopping {
                tracing::warn!("second signal: stopping at once");
                return server.stop_now();
            }
            tracing::info!("stopping: finishing accepted requests");
            server.stop();
            is_stopping = true;
        }
    }
}

/// Handler of Ctrl-C.
#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    /// Installs the handler.
    ///
    /// # Errors
    /// Never fails.
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    /// Forwards Ctrl-C: the first stops the program gracefully, the second at once.
    async fn handle_signals(self, server: ServerHandle) {
        // If waiting for Ctrl-C fails, the system ends the program on Ctrl-C; nothing is left to do.
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop();
        }
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop_now();
        }
    }
}
