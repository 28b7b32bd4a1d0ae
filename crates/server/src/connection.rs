//! One connection: HTTP/1.1 over TLS or plain, with a limit to every way of being slow.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::watch;
use tokio::time::{Instant, Sleep};

use crate::peer::Peer;
use veiloc_admission::{Guest, Place};

/// Most bytes of a request's head. A token, a content type and what proxies add fit in a fraction.
const MAX_HEAD: usize = 16 * 1024;

/// How long the first bytes of a connection are waited for when the service stops.
const FIRST_BYTES: Duration = Duration::from_millis(100);

/// How long a connection may take, and be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conduct {
    /// Head of a request, and pause between two requests.
    pub(crate) head: Duration,
    /// Reading of an answer, as long as nothing is taken.
    pub(crate) write: Duration,
    /// All of it, as long as it brings no token.
    pub(crate) unknown_life: Duration,
    /// All of it.
    pub(crate) life: Duration,
}

/// Answers the requests of one connection until the client leaves, is too slow, has been there for too long, has to make
/// room for another, or `stop` says so. What is being answered then is finished, and the connection closed.
pub(crate) async fn serve_connection<S>(
    stream: S,
    peer: Peer,
    router: Router,
    place: &Place,
    conduct: Conduct,
    mut stop: watch::Receiver<bool>,
) where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let guest = place.guest().clone();
    let router = TowerToHyperService::new(router);
    let answering = guest.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        let guest = answering.clone();
        guest.begin();
        request.extensions_mut().insert(guest.clone());
        let answer = router.call(request);
        async move {
            let answer = answer.await;
            guest.answered();
            answer
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(conduct.head)
        .max_buf_size(MAX_HEAD.max(64 * 1024))
        .max_header_size(MAX_HEAD)
        .serve_connection(TokioIo::new(Patient::new(stream, conduct.write, guest.clone())), service);
    let mut connection = std::pin::pin!(connection);
    // An error here is a client that broke off or spoke no HTTP: nothing that anybody could act on, and its text
    // could hold what was sent.
    tokio::select! {
        biased;
        _ = connection.as_mut() => return,
        () = guest.thrown_out() => return,
        () = peer.left_while(|| guest.is_busy()) => return,
        () = guest.told_to_leave() => {
            // Others wait for its place.
            if guest.is_idle() {
                return;
            }
        }
        () = life(&guest, conduct) => {}
        _ = stop.wait_for(|stop| *stop) => {}
    }
    // One that is idle ends with that, but for one that never sent anything. Its first bytes may be on their way; they
    // are waited for a moment, and not until its time for a head is over.
    connection.as_mut().graceful_shutdown();
    tokio::select! {
        biased;
        _ = connection.as_mut() => return,
        () = guest.thrown_out() => return,
        () = tokio::time::sleep(FIRST_BYTES) => {}
    }
    if !guest.is_idle() {
        tokio::select! {
            _ = connection => {}
            () = guest.thrown_out() => {}
            () = peer.left_while(|| guest.is_busy()) => {}
        }
    }
}

/// Until the connection has been there for as long as it may.
async fn life(guest: &Guest, conduct: Conduct) {
    let first = conduct.unknown_life.min(conduct.life);
    tokio::time::sleep(first).await;
    if guest.is_known() {
        tokio::time::sleep(conduct.life.saturating_sub(first)).await;
    }
}

/// A stream that gives up on a reader who takes nothing for a while: hyper limits how long a client may take to send,
/// not to receive. It also tells the guest what comes and goes.
struct Patient<S> {
    stream: S,
    guest: Arc<Guest>,
    patience: Duration,
    deadline: Pin<Box<Sleep>>,
    waiting: bool,
}

impl<S> Patient<S> {
    fn new(stream: S, patience: Duration, guest: Arc<Guest>) -> Self {
        Self { stream, guest, patience, deadline: Box::pin(tokio::time::sleep(patience)), waiting: false }
    }

    /// Passes on what a write said; one that has been pending for too long becomes an error.
    fn limit<T>(&mut self, polled: Poll<io::Result<T>>, context: &mut Context<'_>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.waiting = false;
            return polled;
        }
        if !self.waiting {
            self.waiting = true;
            self.deadline.as_mut().reset(Instant::now() + self.patience);
        }
        ready!(self.deadline.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Patient<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let polled = Pin::new(&mut self.stream).poll_read(context, buffer);
        if buffer.filled().len() > before {
            self.guest.received();
        }
        polled
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Patient<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.limit(polled, context)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_flush(context);
        if matches!(polled, Poll::Ready(Ok(()))) {
            self.guest.flushed();
        }
        self.limit(polled, context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(context);
        self.limit(polled, context)
    }
}
