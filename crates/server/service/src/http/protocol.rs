//! The two versions of HTTP with their limits, behind one face.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use hyper::body::{Body, Incoming};
use hyper::server::conn::{http1, http2};
use hyper::service::HttpService;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};

/// Which HTTP is spoken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// The first bytes tell: on a plain listener a client that knows may begin with HTTP/2 (RFC 9113, 3.3).
    Unknown,
    /// HTTP/1.1.
    Http1,
    /// HTTP/2.
    Http2,
}

/// Most bytes of a request's head. A token, a content type and what proxies add fit in a fraction.
const MAX_HEAD: usize = 16 * 1024;

/// Requests of one connection of HTTP/2 at a time. A device has one under way, a page a few, a proxy has connections of its
/// own; each may have a body in memory, so this is what a connection may take.
pub const STREAMS: u32 = 8;

/// Streams that a client took back before anybody looked at them; one more, and the connection is closed. What is begun and
/// taken back at once costs the server more than the client (CVE-2023-44487).
const RESET_STREAMS: usize = 16;

/// Faults of a client (frames on closed streams, and the like) until the connection is closed (CVE-2024-27316 and kin).
const FAULTS: usize = 64;

/// What a client may send ahead on one stream, and on all together, bytes: at 100 ms there and back some 10 MB/s.
const STREAM_WINDOW: u32 = 256 * 1024;
const CONNECTION_WINDOW: u32 = 1024 * 1024;

/// Answers that wait on one stream for a slow reader, bytes.
const SEND_BUFFER: usize = 64 * 1024;

/// A client of HTTP/2 is asked so often whether it is still there, and has so long to say it.
const PING_EVERY: Duration = Duration::from_secs(20);
const PONG_WITHIN: Duration = Duration::from_secs(10);

/// A connection that can be told to end after what is under way.
pub(crate) trait Ends: Future<Output = hyper::Result<()>> + Send {
    fn end(self: Pin<&mut Self>);
}

/// A connection of either kind.
pub(crate) type Running = Pin<Box<dyn Ends>>;

/// Body errors as hyper wants them.
type Fault = Box<dyn std::error::Error + Send + Sync>;

impl<I, S, B> Ends for http1::Connection<TokioIo<I>, S>
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: HttpService<Incoming, ResBody = B> + Send,
    S::Error: Into<Fault>,
    S::Future: Send,
    B: Body + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    fn end(self: Pin<&mut Self>) {
        self.graceful_shutdown();
    }
}

impl<I, S, B> Ends for http2::Connection<TokioIo<I>, S, TokioExecutor>
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: HttpService<Incoming, ResBody = B> + Send,
    S::Error: Into<Fault>,
    S::Future: Send + 'static,
    B: Body + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    fn end(self: Pin<&mut Self>) {
        self.graceful_shutdown();
    }
}

/// HTTP/1.1; `head` is how long a head may take, and the pause before it.
pub(crate) fn http1<I, S, B>(stream: I, service: S, head: Duration) -> Running
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: HttpService<Incoming, ResBody = B> + Send + 'static,
    S::Error: Into<Fault>,
    S::Future: Send,
    B: Body + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(head)
        .max_buf_size(MAX_HEAD.max(64 * 1024))
        .max_header_size(MAX_HEAD);
    Box::pin(builder.serve_connection(TokioIo::new(stream), service))
}

/// HTTP/2.
pub(crate) fn http2<I, S, B>(stream: I, service: S) -> Running
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: HttpService<Incoming, ResBody = B> + Send + 'static,
    S::Error: Into<Fault>,
    S::Future: Send + 'static,
    B: Body + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    let mut builder = http2::Builder::new(TokioExecutor::new());
    builder
        .timer(TokioTimer::new())
        .max_concurrent_streams(STREAMS)
        .max_pending_accept_reset_streams(RESET_STREAMS)
        .max_local_error_reset_streams(FAULTS)
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_send_buf_size(SEND_BUFFER)
        .max_header_list_size(MAX_HEAD as u32)
        .keep_alive_interval(PING_EVERY)
        .keep_alive_timeout(PONG_WITHIN)
        // Ours does not change the length of a head (`heads.rs`).
        .auto_date_header(false);
    Box::pin(builder.serve_connection(TokioIo::new(stream), service))
}
