//! One connection of HTTP/1.1, over TLS or plain, with a limit to every way of being slow.

use std::pin::pin;
use std::time::Duration;

use crate::queue::{Guest, Place};
use crate::telemetry::ConnectionFault;
use hyper::body::{Body, Incoming};
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper::{Request, Response};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

use crate::http::answering::Answering;
use crate::http::faults::fault_of;
use crate::http::patient::Patient;
use crate::http::stream::Peer;

/// Most bytes of a request's head. A token, a content type and what proxies add fit in a fraction.
const MAX_HEAD: usize = 16 * 1024;

/// What is buffered of a connection at most, bytes.
const BUFFER: usize = 64 * 1024;

/// How long the first bytes of a connection are waited for when the service stops.
const FIRST_BYTES: Duration = Duration::from_millis(100);

/// How long a connection may take, and be.
#[derive(Debug, Clone, Copy)]
pub struct Conduct {
    /// Head of a request, and pause between two requests.
    pub head: Duration,
    /// Reading of an answer, as long as nothing is taken.
    pub write: Duration,
    /// All of it, as long as it brings no token.
    pub unknown_life: Duration,
    /// All of it.
    pub life: Duration,
}

/// Answers the requests of one connection until the client leaves, is too slow, has been there for too long, has to make
/// room for another, or `ending` says that the service ends. What is being answered then is finished, and the connection
/// closed. Tells what went wrong, if it did not end well.
///
/// Every request carries the connection's `Arc<Guest>` among its extensions.
pub async fn serve_connection<I, S, B>(
    stream: I,
    peer: Peer,
    service: S,
    place: &Place,
    conduct: Conduct,
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
    let guest = place.guest().clone();
    let stream = Patient::new(stream, conduct.write, guest.clone());
    let answered = guest.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        let answering = Answering::begin(answered.clone());
        request.extensions_mut().insert(answered.clone());
        let answer = service.call(request);
        async move { Ok::<_, S::Error>(answer.await?.map(|body| answering.with_body(body))) }
    });
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(conduct.head)
        .max_buf_size(BUFFER)
        .max_header_size(MAX_HEAD);
    let mut connection = pin!(builder.serve_connection(TokioIo::new(stream), service));
    // An error here is a client that broke off or spoke no HTTP. It is counted by its kind; its text could hold what was
    // sent.
    tokio::select! {
        biased;
        ended = connection.as_mut() => return fault_of(&guest, ended),
        () = guest.thrown_out() => return None,
        () = peer.left_while(|| guest.is_busy()) => return Some(ConnectionFault::Left),
        () = guest.told_to_leave() => {
            // Others wait for its place.
            if guest.is_idle() {
                return None;
            }
        }
        () = life(&guest, conduct) => {}
        _ = ending.wait_for(|ending| *ending) => {}
    }
    // One that is idle ends with that, but for one that never sent anything. Its first bytes may be on their way; they
    // are waited for a moment, and not until its time for a head is over.
    connection.as_mut().graceful_shutdown();
    tokio::select! {
        biased;
        ended = connection.as_mut() => return fault_of(&guest, ended),
        () = guest.thrown_out() => return None,
        () = peer.left_while(|| guest.is_busy()) => return Some(ConnectionFault::Left),
        () = tokio::time::sleep(FIRST_BYTES) => {}
    }
    if guest.is_idle() {
        return None;
    }
    tokio::select! {
        ended = connection => fault_of(&guest, ended),
        () = guest.thrown_out() => None,
        () = peer.left_while(|| guest.is_busy()) => Some(ConnectionFault::Left),
    }
}

/// Body errors as hyper wants them.
type Fault = Box<dyn std::error::Error + Send + Sync>;

/// Until the connection has been there for as long as it may.
async fn life(guest: &Guest, conduct: Conduct) {
    let first = conduct.unknown_life.min(conduct.life);
    tokio::time::sleep(first).await;
    if guest.is_known() {
        tokio::time::sleep(conduct.life.saturating_sub(first)).await;
    }
}
