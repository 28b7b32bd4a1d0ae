//! Accepts connections from TCP and Unix sockets.

use std::io::{self, ErrorKind};
use std::net::IpAddr;
use std::task::{Context, Poll, ready};

use socket2::SockRef;
#[cfg(unix)]
use tokio::net::UnixStream;
use tokio::net::{TcpListener, TcpStream};

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

    /// Accepts the next connection that is already pending; `None` if there is none.
    ///
    /// It asks the system, not the runtime: the runtime may not know the newest connections yet.
    pub fn accept_pending(&self) -> Option<(Stream, Option<IpAddr>)> {
        loop {
            let accepted = match &self.0 {
                Socket::Tcp(listener) => SockRef::from(listener).accept(),
                #[cfg(unix)]
                Socket::Unix(socket) => SockRef::from(socket.listener()).accept(),
            };
            match accepted {
                Ok((socket, from)) => {
                    if let Ok(stream) = self.stream_of(socket) {
                        return Some((stream, from.as_socket().map(|address| address.ip())));
                    }
                }
                // The client is gone already.
                Err(error)
                    if matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) => {}
                Err(_) => return None,
            }
        }
    }

    fn stream_of(&self, socket: socket2::Socket) -> io::Result<Stream> {
        socket.set_nonblocking(true)?;
        Ok(match &self.0 {
            Socket::Tcp(_) => Stream::Tcp(without_delay(TcpStream::from_std(socket.into())?)),
            #[cfg(unix)]
            Socket::Unix(_) => Stream::Unix(UnixStream::from_std(socket.into())?),
        })
    }

    /// Accepts the next connection; returns its address, or `None` for a Unix socket.
    ///
    /// # Errors
    /// The error of the system, mostly too many open files.
    pub async fn accept(&self) -> io::Result<(Stream, Option<IpAddr>)> {
        std::future::poll_fn(|context| self.poll_accept(context)).await
    }

    fn poll_accept(&self, context: &mut Context<'_>) -> Poll<io::Result<(Stream, Option<IpAddr>)>> {
        Poll::Ready(match &self.0 {
            Socket::Tcp(listener) => ready!(listener.poll_accept(context))
                .map(|(stream, from)| (Stream::Tcp(without_delay(stream)), Some(from.ip()))),
            #[cfg(unix)]
            Socket::Unix(socket) => {
                ready!(socket.poll_accept(context)).map(|stream| (Stream::Unix(stream), None))
            }
        })
    }
}

/// Responses are small, so waiting to fill a packet only delays them. A failure here is no reason to refuse the
/// connection.
fn without_delay(stream: TcpStream) -> TcpStream {
    let _ = stream.set_nodelay(true);
    stream
}

#[cfg(test)]
mod tests {
    use std::task::Waker;

    use super::*;

    /// A listener on one thread, so that the runtime does nothing between the lines.
    async fn accepts_what_the_runtime_does_not_know(
        address: ListenAddress,
        connect: impl Fn(&ListenAddress),
    ) {
        let listener = Listener::bind(&address, 0o600).await.expect("bound");
        assert!(listener.accept_pending().is_none(), "no connection, and the call does not wait");
        let address = listener.address().expect("an address");
        (0..3).for_each(|_| connect(&address));
        assert!(listener.poll_accept(&mut Context::from_waker(Waker::noop())).is_pending());
        let accepted: Vec<_> = std::iter::from_fn(|| listener.accept_pending()).collect();
        assert_eq!(accepted.len(), 3);
        let has_address = matches!(address, ListenAddress::Tcp(_));
        assert!(accepted.iter().all(|(_, from)| from.is_some() == has_address));
    }

    #[tokio::test]
    async fn pending_connections_are_accepted_before_the_runtime_knows_them() {
        let loopback = ListenAddress::Tcp("127.0.0.1:0".parse().expect("an address"));
        accepts_what_the_runtime_does_not_know(loopback, |address| {
            let address = address.tcp().expect("over TCP");
            // The system completes the connection; the client leaves, and its connection stays pending.
            std::net::TcpStream::connect(address).expect("connected");
        })
        .await;
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn pending_connections_of_a_unix_socket_are_accepted() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.sock");
        accepts_what_the_runtime_does_not_know(ListenAddress::Unix(path.clone()), |_| {
            std::os::unix::net::UnixStream::connect(&path).expect("connected");
        })
        .await;
    }
}
