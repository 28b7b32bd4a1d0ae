//! Where to listen: a TCP port, or a Unix socket; and why that may be impossible.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

/// Where to listen.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ListenAddress {
    /// Address and port; port 0 for any free one.
    Tcp(SocketAddr),
    /// The path of a socket of the file system.
    Unix(PathBuf),
}

/// A text that is neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("ADDRESS:PORT (127.0.0.1:8080, [::]:8443) or unix:PATH (unix:/run/veiloc/veiloc.sock) is expected")]
pub struct BadAddress;

/// Why nothing can be listened to there.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ListenError {
    /// The system refused.
    #[error("{0}")]
    System(#[from] io::Error),
    /// Somebody answers on the socket.
    #[error("another process answers there; stop it first")]
    Answered,
    /// The path is taken by something else.
    #[error(
        "there is a file there that is no socket; it is left alone, so take it away, or choose another path"
    )]
    NoSocket,
    /// The system knows no such sockets.
    #[error("this system has no Unix sockets")]
    Unknown,
}

impl ListenAddress {
    /// Whether nobody beyond this machine can reach it: loopback, or a socket of the file system.
    pub fn is_local(&self) -> bool {
        match self {
            Self::Tcp(address) => address.ip().is_loopback(),
            Self::Unix(_) => true,
        }
    }

    /// The TCP address, if it is one.
    pub const fn tcp(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(address) => Some(*address),
            Self::Unix(_) => None,
        }
    }
}

impl From<SocketAddr> for ListenAddress {
    fn from(address: SocketAddr) -> Self {
        Self::Tcp(address)
    }
}

impl FromStr for ListenAddress {
    type Err = BadAddress;

    fn from_str(text: &str) -> Result<Self, BadAddress> {
        match text.strip_prefix("unix:") {
            Some("") => Err(BadAddress),
            Some(path) => Ok(Self::Unix(path.into())),
            None => text.parse().map(Self::Tcp).map_err(|_| BadAddress),
        }
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_are_read_and_written() {
        for (text, local) in [
            ("127.0.0.1:8080", true),
            ("[::1]:0", true),
            ("0.0.0.0:443", false),
            ("[::]:443", false),
            ("unix:/run/v.sock", true),
            ("unix:v.sock", true),
        ] {
            let address: ListenAddress = text.parse().expect(text);
            assert_eq!((address.to_string().as_str(), address.is_local()), (text, local));
        }
        for bad in ["", "8080", "localhost:80", "unix:", "unix", "/run/v.sock", "127.0.0.1"] {
            assert_eq!(bad.parse::<ListenAddress>(), Err(BadAddress), "{bad}");
        }
    }
}
