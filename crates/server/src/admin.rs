//! A listener of its own for probes and metrics: whatever happens where queries come in, the operator is answered.
//!
//! It speaks plain HTTP and asks for no token, so it belongs where only the operator reaches it: loopback, or the
//! network of a cluster. There is nothing of a query on it, and no way to localize.

use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::connection::{Conduct, serve_connection};
use crate::peer::share;
use crate::routes::admin_router;
use crate::state::App;
use veiloc_admission::{Connections, Entry, Limits};

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
            let (stream, peer) = share(stream);
            serve_connection(stream, peer, router, &place, conduct, stop).await;
        });
    }
}
