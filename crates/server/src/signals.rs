//! A program that is nothing but the service: its threads, and the signals that stop it or make it read files again.

use crate::descriptors;
use crate::error::ServerError;
use crate::options::ServerOptions;
use crate::panics;
use crate::serve::{Listening, Server, ServerHandle, Stopped};

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
    descriptors::make_room(&options)?;
    panics::own_process();
    let system = |what| move |source| ServerError::System { what, source };
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().on_thread_start(panics::mark).build();
    let runtime = runtime.map_err(system("a runtime"))?;
    let stopped = runtime.block_on(async {
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

#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    hang_up: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    async fn obey(mut self, server: ServerHandle) {
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

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn obey(self, server: ServerHandle) {
        // Without a handler for Ctrl-C the system ends the program, which is all there is left to do.
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop();
        }
        if tokio::signal::ctrl_c().await.is_ok() {
            server.stop_now();
        }
    }
}
