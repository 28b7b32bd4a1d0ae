//! A listener of its own for probes and metrics: whatever happens where queries come in, the operator is answered.
//!
//! It speaks plain HTTP and asks for no token, so it belongs where only the operator reaches it: loopback, or the
//! network of a cluster. There is nothing of a query on it, and no way to localize.

use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::connection::{Conduct, serve_connection};
use crate::connections::{Connections, Entry, Limits};
use crate::routes::admin_router;
use crate::state::App;

/// Connections at a time; one more takes the place of the one that is idle for longest.
pub(crate) const CONNECTIONS: usize = 64;

/// Longest a connection stays open.
const LIFE: Duration = Duration::from_secs(600);

/// Answers until it is dropped or `stop` says so.
pub(crate) async fn serve(app: Arc<App>, listener: TcpListener, mut stop: watch::Receiver<bool>) {
    let connections = Connections::new(Limits { total: CONNECTIONS, per_address: CONNECTIONS, reserved: 0 });
    let router = admin_router(app.clone());
    let timeouts = app.options.timeouts;
    let conduct = Conduct { head: timeouts.head, write: timeouts.write, unknown_life: LIFE, life: LIFE };
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stop.wait_for(|stop| *stop) => return,
        };
        let Ok((stream, from)) = accepted else {
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        let (Entry::Taken(place) | Entry::Exchanged(place)) = connections.enter(from.ip()) else { continue };
        let (router, stop) = (router.clone(), stop.clone());
        tokio::spawn(async move {
            let _ = stream.set_nodelay(true);
            serve_connection(stream, router, &place, conduct, stop).await;
        });
    }
}

/// The port beside that of the service, so that two services of one machine differ in both; any free one for any free one.
pub(crate) const fn default_port(listen: u16) -> u16 {
    match listen {
        0 => 0,
        u16::MAX => u16::MAX - 1,
        port => port + 1,
    }
}
