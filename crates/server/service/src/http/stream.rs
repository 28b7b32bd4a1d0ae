//! A stream of TCP or of a Unix socket that can be asked whether its other side has left, while somebody else reads and writes it.
//!
//! A client that gives up closes its end, and its query must not be computed any more. Reading would tell, but not while
//! bytes of a next request lie before the end: those are not read before the answer to this one is made. The system knows
//! of the end all the same.

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

/// How soon it is noticed that a client has left.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// A connection as it was accepted.
pub enum Stream {
    /// Of TCP.
    Tcp(TcpStream),
    /// Of a Unix socket.
    #[cfg(unix)]
    Unix(UnixStream),
}

/// Does the same with either kind.
macro_rules! either {
    ($stream:expr, $inner:ident => $done:expr) => {
        match $stream {
            Stream::Tcp($inner) => $done,
            #[cfg(unix)]
            Stream::Unix($inner) => $done,
        }
    };
}

/// The stream to read and write.
pub struct Shared(Arc<Stream>);

/// The stream to ask.
#[derive(Clone)]
pub struct Peer(Arc<Stream>);

impl Stream {
    /// Both sides of it.
    pub fn share(self) -> (Shared, Peer) {
        let stream = Arc::new(self);
        (Shared(stream.clone()), Peer(stream))
    }
}

impl Peer {
    /// Whether the other side has closed its end, or the connection broke.
    fn has_left(&self) -> bool {
        either!(&*self.0, stream => {
            let ready = pin!(stream.ready(Interest::READABLE));
            match ready.poll(&mut Context::from_waker(Waker::noop())) {
                Poll::Ready(Ok(ready)) => ready.is_read_closed(),
                Poll::Ready(Err(_)) => true,
                Poll::Pending => false,
            }
        })
    }

    /// Waits until it has left while `waits` is so: with nothing going on, reading tells.
    pub(crate) async fn left_while(&self, waits: impl Fn() -> bool) {
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            if waits() && self.has_left() {
                return;
            }
        }
    }
}

impl AsyncRead for Shared {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        loop {
            ready!(either!(&*self.0, stream => stream.poll_read_ready(context)))?;
            match either!(&*self.0, stream => stream.try_read(buffer.initialize_unfilled())) {
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

impl AsyncWrite for Shared {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        loop {
            ready!(either!(&*self.0, stream => stream.poll_write_ready(context)))?;
            match either!(&*self.0, stream => stream.try_write(bytes)) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                written => return Poll::Ready(written),
            }
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(either!(&*self.0, stream => SockRef::from(stream).shutdown(Shutdown::Write)))
    }
}
