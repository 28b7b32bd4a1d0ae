//! One HTTP/1.1 connection, over TLS or plain, with a time limit for each phase.

use std::pin::pin;
use std::time::Duration;

use crate::queue::{Connection, Slot};
use crate::telemetry::ConnectionFault;
use hyper::body::{Body, Incoming};
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper::{Request, Response};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

use crate::http::faults::fault_of;
use crate::http::in_flight::InFlightRequest;
use crate::http::stream::PeerWatch;
use crate::http::write_timeout::WriteTimeoutStream;

/// Maximum length of a request head. A token, a content type and what proxies add need a fraction of it.
const MAX_HEAD: usize = 16 * 1024;

/// Maximum buffer per connection, bytes.
const BUFFER: usize = 64 * 1024;

/// Wait for the first bytes of a connection during shutdown.
const FIRST_BYTES: Duration = Duration::from_millis(100);

/// Time limits of a connection.
#[derive(Debug, Clone, Copy)]
pub struct ConnectionTimeouts {
    /// Receiving a request head, and idle time between two requests.
    pub head: Duration,
    /// Longest stall while the client reads a response.
    pub write: Duration,
    /// Lifetime while unauthenticated.
    pub unauthenticated_max_age: Duration,
    /// Lifetime.
    pub max_age: Duration,
}

/// Serves one connection until the client disconnects or is too slow, the lifetime ends, the connection is evicted,
/// or `ending` becomes true. A request in flight is then finished and the connection closed. Returns the fault if the
/// connection ended abnormally.
///
/// Every request has the `Arc<Connection>` among its extensions.
pub async fn serve_connection<I, S, B>(
    stream: I,
    peer: PeerWatch,
    service: S,
    slot: &Slot,
    connection_timeouts: ConnectionTimeouts,
    mut ending: watch::Receiver<bool>,
) -> Option<ConnectionFault>
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: Service<Request<Incoming>, Response = Response<B>> + Send + Sync + 'static,
    S::Error: Into<Fault> + Send,
    S::Future: Send + 'static,
    B: Body + Unpin + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    let connection = slot.connection().clone();
    let stream = WriteTimeoutStream::new(stream, connection_timeouts.write, connection.clone());
    let served = connection.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        let in_flight = InFlightRequest::begin(served.clone());
        request.extensions_mut().insert(served.clone());
        let answer = service.call(request);
        async move { Ok::<_, S::Error>(answer.await?.map(|body| in_flight.with_body(body))) }
    });
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(connection_timeouts.head)
        .max_buf_size(BUFFER)
        .max_header_size(MAX_HEAD);
    let mut serving = pin!(builder.serve_connection(TokioIo::new(stream), service));
    // Errors here are clients that disconnected or did not speak HTTP. Only the kind is counted, because the text
    // could contain input.
    tokio::select! {
        biased;
        ended = serving.as_mut() => return fault_of(&connection, ended),
        () = connection.force_closed() => return None,
        () = peer.disconnected_while(|| connection.is_busy()) => return Some(ConnectionFault::Left),
        () = connection.evicted() => {
            // The slot is already given to another connection.
            if connection.is_idle() {
                return None;
            }
        }
        () = life(&connection, connection_timeouts) => {}
        _ = ending.wait_for(|ending| *ending) => {}
    }
    // An idle connection ends here, except one that never sent anything: hyper would wait for its first head until
    // the timeout. Its first bytes may be on their way, so wait only a moment.
    serving.as_mut().graceful_shutdown();
    tokio::select! {
        biased;
        ended = serving.as_mut() => return fault_of(&connection, ended),
        () = connection.force_closed() => return None,
        () = peer.disconnected_while(|| connection.is_busy()) => return Some(ConnectionFault::Left),
        () = tokio::time::sleep(FIRST_BYTES) => {}
    }
    if connection.is_idle() {
        return None;
    }
    tokio::select! {
        ended = serving => fault_of(&connection, ended),
        () = connection.force_closed() => None,
        () = peer.disconnected_while(|| connection.is_busy()) => Some(ConnectionFault::Left),
    }
}

/// Error type of bodies in hyper.
type Fault = Box<dyn std::error::Error + Send + Sync>;

/// Returns when the lifetime of the connection is over.
async fn life(connection: &Connection, connection_timeouts: ConnectionTimeouts) {
    let first = connection_timeouts.unauthenticated_max_age.min(connection_timeouts.max_age);
    tokio::time::sleep(first).await;
    if connection.is_authenticated() {
        tokio::time::sleep(connection_timeouts.max_age.saturating_sub(first)).await;
    }
}
