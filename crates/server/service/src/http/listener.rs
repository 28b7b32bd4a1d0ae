//! Accepts connections from TCP and Unix sockets.

use std::io;
use std::net::IpAddr;
use std::task::{Context, Poll, ready};

use tokio::net::TcpListener;

use crate::http::address::{ListenAddress, ListenError};
use crate::http::stream::Stream;
#[cfg(unix)]
use crate::http::unix::UnixSocket;

/// A bound listener.
pub struct Listener(Socket);

enum Socket {
    Tcp(TcpListener),
    #[cfg(unix)]
    Unix(UnixSocket),
}

impl Listener {
    /// Binds the address.
    ///
    /// `mode` is the file mode of a Unix socket and controls who may connect. A socket left behind by a dead process
    /// is replaced; a socket on which a process answers, and any other file, is not touched.
    ///
    /// # Errors
    /// [`ListenError`]
    pub async fn bind(address: &ListenAddress, mode: u32) -> Result<Self, ListenError> {
        match address {
            ListenAddress::Tcp(address) => Ok(Self(Socket::Tcp(TcpListener::bind(address).await?))),
            #[cfg(unix)]
            ListenAddress::Unix(path) => Ok(Self(Socket::Unix(UnixSocket::bind(path, mode)?))),
            #[cfg(not(unix))]
            ListenAddress::Unix(_) => {
                let _ = mode;
                Err(ListenError::Unknown)
            }
        }
    }

    /// The bound address, with the actual port.
    ///
    /// # Errors
    /// The error of the system.
    pub fn address(&self) -> io::Result<ListenAddress> {
        Ok(match &self.0 {
            Socket::Tcp(listener) => ListenAddress::Tcp(listener.local_addr()?),
            #[cfg(unix)]
            Socket::Unix(socket) => ListenAddress::Unix(socket.path().to_owned()),
        })
    }

    /// Whether the listener uses TLS if a certificate is configured: over TCP, but not on a Unix socket.
    pub const fn may_speak_tls(&self) -> bool {
        matches!(self.0, Socket::Tcp(_))
    }

    /// Accepts the next connection; returns its address, or `None` for a Unix socket.
    ///
    /// # Errors
    /// The error of the system, mostly too many open files.
    pub async fn accept(&self) -> io::Result<(Stream, Option<IpAddr>)> {
        std::future::poll_fn(|context| self.poll_accept(context)).await
    }

    /// As [`Self::accept`], without waiting.
    pub fn poll_accept(&self, context: &mut Context<'_>) -> Poll<io::Result<(Stream, Option<IpAddr>)>> {
        Poll::Ready(match &self.0 {
            Socket::Tcp(listener) => ready!(listener.poll_accept(context)).map(|(stream, from)| {
                // Responses are small, so waiting to fill a packet only delays them. A failure here is no reason to
                // refuse the connection.
                let _ = stream.set_nodelay(true);
                (Stream::Tcp(stream), Some(from.ip()))
            }),
            #[cfg(unix)]
            Socket::Unix(socket) => {
                ready!(socket.poll_accept(context)).map(|stream| (Stream::Unix(stream), None))
            }
        })
    }
}
