//! A TCP or Unix stream that can be checked for disconnection of the peer while another task reads and writes it.
//!
//! When a client disconnects, its query must be cancelled. Reading would notice this, but not while bytes of a
//! pipelined request are unread: these are read only after the current response. The readiness state of the socket
//! shows it anyway.

use std::io;
use std::net::Shutdown;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Waker, ready};
use std::time::Duration;

use socket2::SockRef;
use tokio::io::{AsyncRead, AsyncWrite, Interest, ReadBuf};
use tokio::net::TcpStream;
#[cfg(unix)]
use tokio::net::UnixStream;

/// Polling interval for disconnection.
const POLL_INTERVAL: Duration = Duration::from_millis(250);

/// An accepted connection.
pub enum Stream {
    /// TCP.
    Tcp(TcpStream),
    /// A Unix socket.
    #[cfg(unix)]
    Unix(UnixStream),
}

/// Evaluates the same expression for either kind of stream.
macro_rules! with_stream {
    ($stream:expr, $inner:ident => $done:expr) => {
        match $stream {
            Stream::Tcp($inner) => $done,
            #[cfg(unix)]
            Stream::Unix($inner) => $done,
        }
    };
}

/// The half that reads and writes.
pub struct SharedStream(Arc<Stream>);

/// The half that checks for disconnection.
#[derive(Clone)]
pub struct PeerWatch(Arc<Stream>);

impl Stream {
    /// Splits the stream into both halves.
    pub fn share(self) -> (SharedStream, PeerWatch) {
        let stream = Arc::new(self);
        (SharedStream(stream.clone()), PeerWatch(stream))
    }
}

impl PeerWatch {
    /// Whether the peer has closed its end, or the connection broke.
    fn has_disconnected(&self) -> bool {
        with_stream!(&*self.0, stream => {
            let ready = pin!(stream.ready(Interest::READABLE));
            match ready.poll(&mut Context::from_waker(Waker::noop())) {
                Poll::Ready(Ok(ready)) => ready.is_read_closed(),
                Poll::Ready(Err(_)) => true,
                Poll::Pending => false,
            }
        })
    }

    /// Returns when the peer has disconnected while `waits()` is true. When no request is in flight, reading notices
    /// it.
    pub(crate) async fn disconnected_while(&self, waits: impl Fn() -> bool) {
        loop {
            tokio::time::sleep(POLL_INTERVAL).await;
            if waits() && self.has_disconnected() {
                return;
            }
        }
    }
}

impl AsyncRead for SharedStream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        loop {
            ready!(with_stream!(&*self.0, stream => stream.poll_read_ready(context)))?;
            match with_stream!(&*self.0, stream => stream.try_read(buffer.initialize_unfilled())) {
                Ok(count) => {
                    buffer.advance(count);
                    return Poll::Ready(Ok(()));
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }
}

impl AsyncWrite for SharedStream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        loop {
            ready!(with_stream!(&*self.0, stream => stream.poll_write_ready(context)))?;
            match with_stream!(&*self.0, stream => stream.try_write(bytes)) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                written => return Poll::Ready(written),
            }
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(with_stream!(&*self.0, stream => SockRef::from(stream).shutdown(Shutdown::Write)))
    }
}
