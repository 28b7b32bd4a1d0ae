//! Listen addresses: a TCP port or a Unix socket; and errors of binding.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

/// A listen address.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ListenAddress {
    /// Address and port; port 0 for any free one.
    Tcp(SocketAddr),
    /// The path of a Unix socket.
    Unix(PathBuf),
}

/// The text is neither form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected ADDRESS:PORT (127.0.0.1:8080, [::]:8443) or unix:PATH (unix:/run/veiloc/veiloc.sock)")]
pub struct InvalidAddress;

/// Why an address cannot be bound.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ListenError {
    /// The system refused.
    #[error("{0}")]
    System(#[from] io::Error),
    /// Another process answers on the socket.
    #[error("another process answers there; stop it first")]
    Answered,
    /// The path is taken by a file that is not a socket.
    #[error("the path is a file that is no socket; remove it, or choose another path")]
    NoSocket,
    /// The system has no Unix sockets.
    #[error("this system has no Unix sockets")]
    Unknown,
}

impl ListenAddress {
    /// Whether only this machine can reach the address: loopback, or a Unix socket.
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
    type Err = InvalidAddress;

    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        match text.strip_prefix("unix:") {
            Some("") => Err(InvalidAddress),
            Some(path) => Ok(Self::Unix(path.into())),
            None => text.parse().map(Self::Tcp).map_err(|_| InvalidAddress),
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
    fn addresses_round_trip() {
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
            assert_eq!(bad.parse::<ListenAddress>(), Err(InvalidAddress), "{bad}");
        }
    }
}
