//! A listener of its own for probes and metrics: whatever happens where queries come in, the operator is answered.
//!
//! It speaks plain HTTP and asks for no token, so it belongs where only the operator reaches it: loopback, or the
//! network of a cluster. There is nothing of a query on it, and no way to localize.

use std::sync::Arc;
use std::time::Duration;

use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;

use crate::routes::admin_router;
use crate::state::App;
use veiloc_admission::{Connections, Entry, Limits};
use veiloc_transport::{Conduct, Ending, Listener, Protocol, serve_connection};

/// Connections at a time; one more takes the place of the one that is idle for longest.
pub(crate) const CONNECTIONS: usize = 64;

/// Longest a connection stays open.
const LIFE: Duration = Duration::from_secs(600);

/// Answers until it is dropped or `stop` says so.
pub(crate) async fn serve(app: Arc<App>, listener: Listener, mut stop: watch::Receiver<bool>) {
    let connections = Connections::new(Limits { total: CONNECTIONS, per_address: CONNECTIONS, reserved: 0 });
    let router = admin_router(app.clone());
    let conduct = Conduct { unknown_life: LIFE, life: LIFE, ..app.options.timeouts.conduct() };
    let ending = watch::Sender::new(Ending::Serving);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stop.wait_for(|stop| *stop) => {
                ending.send_replace(Ending::Closing);
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
            serve_connection(stream, peer, Protocol::Unknown, service, &place, conduct, ending).await;
        });
    }
}
