//! How the service is reached, without a word about what it serves: listeners, TLS, and connections of HTTP/1.1
//! with a limit to every way of being slow.
//!
//! - [`ListenAddress`], [`Listener`]: a TCP port or a Unix socket.
//! - [`Tls`]: certificate, key and the authorities of clients, from files that may be replaced ([`Attempts`]).
//! - [`serve_connection`]: the requests of one connection, given to any service of hyper's, until it ends; [`Conduct`] says
//!   how long anything may take.
//!
//! Who is let in, and who has to make room, is `veiloc_service::queue`'s; what is answered is `veiloc-service`'s.
#![forbid(unsafe_code)]

mod address;
mod answering;
mod attempts;
mod connection;
mod expiry;
mod faults;
mod listener;
mod patient;
mod stream;
mod tls;
#[cfg(unix)]
mod unix;

pub use address::{BadAddress, ListenAddress, ListenError};
pub use attempts::Attempts;
pub use connection::{Conduct, serve_connection};
pub use listener::Listener;
pub use stream::{Peer, Shared, Stream};
pub use tls::{Tls, TlsError, TlsFiles};
