//! Errors of the service; each message names the remedy.

use std::path::PathBuf;

use crate::http::{ListenAddress, ListenError, TlsError};
use veiloc_map::MapError;

/// Why the service could not start, or a file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServerError {
    /// No map is configured.
    #[error("no map to serve; give at least one")]
    NoMap,
    /// The map name cannot be part of a URL.
    #[error("{name:?} cannot name a map in an address; use letters, digits, `-`, `_` and `.`, at most 64")]
    MapName {
        /// The name.
        name: String,
    },
    /// Two maps have the same name.
    #[error("two maps are called {name:?}; give each its own name")]
    TwoMaps {
        /// The name.
        name: String,
    },
    /// A geographic reference of a map that is not served.
    #[error("the geographic reference of {name:?} is of no map that is served; give it the name of one")]
    GeoReference {
        /// The name.
        name: String,
    },
    /// Plain HTTP on an address that other machines can reach.
    #[error(
        "plain HTTP on {listen} could be read and changed on the way; give a certificate and its key, or, when a \
         proxy in front of the service does TLS, say so with --insecure-http"
    )]
    PlainHttp {
        /// The address.
        listen: ListenAddress,
    },
    /// No tokens on an address that other machines can reach.
    #[error(
        "anyone who can reach {listen} could send queries; give a file of tokens, or allow this with --allow-anonymous"
    )]
    Anonymous {
        /// The address.
        listen: ListenAddress,
    },
    /// No address to listen on.
    #[error("no address to listen on; give at least one")]
    NoListener,
    /// No connection would be left for unauthenticated clients.
    #[error(
        "{reserved} of {connections} connections cannot be reserved: a client sends its token on an unreserved one"
    )]
    Reserved {
        /// Number of connections to reserve.
        reserved: usize,
        /// Number of all connections.
        connections: usize,
    },
    /// The system allows fewer open files than the configured connections need.
    #[error(
        "{connections} connections need {needed} open files, and the system allows {allowed}; lower --connections, or \
         raise the limit (`ulimit -n {needed}`, systemd: `LimitNOFILE={needed}`)"
    )]
    OpenFiles {
        /// Configured connections.
        connections: usize,
        /// Open files that are needed in total.
        needed: u64,
        /// Open files that the system allows after raising the limit as far as possible.
        allowed: u64,
    },
    /// The address is in use, or does not belong to this machine.
    #[error(
        "cannot listen on {listen}: {source}; choose another address (--listen, --admin-listen) or stop what uses it"
    )]
    Listen {
        /// The address.
        listen: ListenAddress,
        /// Why.
        source: ListenError,
    },
    /// A map cannot be opened.
    #[error("map {name}: {source}")]
    Map {
        /// Its name.
        name: String,
        /// What is wrong with its file.
        source: MapError,
    },
    /// A file could not be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file of tokens is invalid or holds no token.
    #[error("{}: {source}", path.display())]
    Tokens {
        /// Which file.
        path: PathBuf,
        /// What is wrong. The message does not repeat the line, because the line may hold a secret.
        source: crate::auth::TokensError,
    },
    /// Traces cannot be sent to this collector.
    #[error("traces cannot be sent: {source}")]
    Collector {
        /// Why.
        source: std::io::Error,
    },
    /// The certificate, its key or the client authorities cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// Client certificates are required, but the service has no TLS.
    #[error("client certificates need TLS; give the service a certificate and its key (--cert, --key)")]
    ClientsWithoutTls,
    /// The system refused threads, signal handlers or randomness.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was requested.
        what: &'static str,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The page was not found.
    #[error(
        "the page is neither in {} nor in {}; build it with bindings/web/build.sh, or say where it is with \
         --page-folder (the npm package has it in node_modules/veiloc/page)",
        beside.display(), shared.display()
    )]
    NoPage {
        /// The folder next to the program.
        beside: PathBuf,
        /// The folder where packages install it.
        shared: PathBuf,
    },
    /// The folder is not a complete page.
    #[error("{}: {missing} is missing, so this is no built page; build it with bindings/web/build.sh", path.display())]
    PageIncomplete {
        /// The folder.
        path: PathBuf,
        /// The missing file.
        missing: &'static str,
    },
    /// The folder is larger than the limit for a page.
    #[error("{}: larger than any page, 64 MiB; give the folder that bindings/web/build.sh makes", path.display())]
    PageTooLarge {
        /// The folder.
        path: PathBuf,
    },
    /// The file name is not allowed in a page.
    #[error("{name:?} is no file of a page: letters, digits, `-`, `_` and `.`, with a known ending")]
    PageName {
        /// The name.
        name: String,
    },
}
