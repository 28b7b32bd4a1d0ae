//! Taking connections, from TCP and from Unix sockets alike.

use std::io;
use std::net::IpAddr;
use std::task::{Context, Poll, ready};

use tokio::net::TcpListener;

use crate::http::address::{ListenAddress, ListenError};
use crate::http::stream::Stream;
#[cfg(unix)]
use crate::http::unix::UnixSocket;

/// A bound listener.
pub struct Listener(Kind);

enum Kind {
    Tcp(TcpListener),
    #[cfg(unix)]
    Unix(UnixSocket),
}

impl Listener {
    /// Binds it.
    ///
    /// A socket's file can be connected to by whoever may read and write it by `mode`. One that a process left behind
    /// when it died is replaced; one that somebody answers on, and whatever is no socket, is left alone.
    ///
    /// # Errors
    /// [`ListenError`]
    pub async fn bind(address: &ListenAddress, mode: u32) -> Result<Self, ListenError> {
        match address {
            ListenAddress::Tcp(address) => Ok(Self(Kind::Tcp(TcpListener::bind(address).await?))),
            #[cfg(unix)]
            ListenAddress::Unix(path) => Ok(Self(Kind::Unix(UnixSocket::bind(path, mode)?))),
            #[cfg(not(unix))]
            ListenAddress::Unix(_) => {
                let _ = mode;
                Err(ListenError::Unknown)
            }
        }
    }

    /// Where it listens in fact: the port, where any was asked for.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> io::Result<ListenAddress> {
        Ok(match &self.0 {
            Kind::Tcp(listener) => ListenAddress::Tcp(listener.local_addr()?),
            #[cfg(unix)]
            Kind::Unix(socket) => ListenAddress::Unix(socket.path().to_owned()),
        })
    }

    /// Whether TLS is spoken here when there is a certificate: over TCP, and not to a proxy of this machine.
    pub const fn may_speak_tls(&self) -> bool {
        matches!(self.0, Kind::Tcp(_))
    }

    /// The next connection, and the address it comes from; by a Unix socket comes a proxy, behind which may be anybody.
    ///
    /// # Errors
    /// What the system says: mostly that there are too many open files.
    pub async fn accept(&self) -> io::Result<(Stream, Option<IpAddr>)> {
        std::future::poll_fn(|context| self.poll_accept(context)).await
    }

    /// The same for whoever does not wait.
    pub fn poll_accept(&self, context: &mut Context<'_>) -> Poll<io::Result<(Stream, Option<IpAddr>)>> {
        Poll::Ready(match &self.0 {
            Kind::Tcp(listener) => ready!(listener.poll_accept(context)).map(|(stream, from)| {
                // Answers are small: waiting to fill a packet only delays them. Not worth refusing a connection over.
                let _ = stream.set_nodelay(true);
                (Stream::Tcp(stream), Some(from.ip()))
            }),
            #[cfg(unix)]
            Kind::Unix(socket) => {
                ready!(socket.poll_accept(context)).map(|stream| (Stream::Unix(stream), None))
            }
        })
    }
}
