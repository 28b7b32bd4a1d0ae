//! The network layer, independent of what is served: listeners, TLS, and HTTP/1.1 connections with time limits.
//!
//! - [`ListenAddress`], [`Listener`]: a TCP port or a Unix socket.
//! - [`Tls`]: certificate, key and the authorities of clients, from files that may be replaced ([`ReloadAttempts`]).
//! - [`serve_connection`]: serves the requests of one connection with any hyper service; [`ConnectionTimeouts`] holds
//!   the time limits.
//!
//! `crate::queue` decides which connections are admitted and evicted; `crate::routes` answers requests.
#![forbid(unsafe_code)]

mod address;
mod attempts;
mod connection;
pub(crate) mod cors;
mod expiry;
mod faults;
mod in_flight;
mod listener;
pub(crate) mod origin;
pub(crate) mod padding;
pub(crate) mod problem;
mod stream;
mod tls;
#[cfg(unix)]
mod unix;
mod write_timeout;

pub use address::{InvalidAddress, ListenAddress, ListenError};
pub use attempts::ReloadAttempts;
pub use connection::{ConnectionTimeouts, serve_connection};
pub use listener::Listener;
pub use stream::{PeerWatch, SharedStream, Stream};
pub use tls::{Tls, TlsError, TlsFiles, Validity};
