//! Why the service could not start or go on, with the remedy.

use std::net::SocketAddr;
use std::path::PathBuf;

use veiloc_map::MapError;

/// Why the service could not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServerError {
    /// Nothing to serve.
    #[error("no map to serve; give at least one")]
    NoMap,
    /// A name that would need escaping.
    #[error("{name:?} cannot name a map in an address; use letters, digits, `-`, `_` and `.`, at most 64")]
    MapName {
        /// The name.
        name: String,
    },
    /// One name for two maps.
    #[error("two maps are called {name:?}; give each its own name")]
    TwoMaps {
        /// The name.
        name: String,
    },
    /// Plain HTTP where others can listen.
    #[error(
        "plain HTTP on {listen} could be read and changed on the way; give a certificate and its key, or, when a \
         proxy in front of the service does TLS, say so with --insecure-http"
    )]
    PlainHttp {
        /// Where it was to listen.
        listen: SocketAddr,
    },
    /// No tokens where negatives can ask.
    #[error(
        "everybody who reaches {listen} could ask; give a file of tokens, or say that this is meant with \
         --allow-anonymous"
    )]
    Anonymous {
        /// Where it was to listen.
        listen: SocketAddr,
    },
    /// No connection would be left for who is not known yet.
    #[error(
        "of {connections} connections {reserved} cannot be reserved; who brings a token needs one to bring it on"
    )]
    Reserved {
        /// How many were to be reserved.
        reserved: usize,
        /// How many there are.
        connections: usize,
    },
    /// The system allows fewer open files than there may be connections.
    #[error(
        "{connections} connections need {needed} open files, and the system allows {allowed}; lower --connections, or \
         raise the limit (`ulimit -n {needed}`, systemd: `LimitNOFILE={needed}`)"
    )]
    OpenFiles {
        /// How many connections were asked for.
        connections: usize,
        /// Open files that they need, all others included.
        needed: u64,
        /// How many are allowed, the limit raised as far as it goes.
        allowed: u64,
    },
    /// The address is taken or not ours.
    #[error(
        "cannot listen on {listen}: {source}; choose another address (--listen, --admin-listen) or stop what uses it"
    )]
    Listen {
        /// The address.
        listen: SocketAddr,
        /// What the system said.
        source: std::io::Error,
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
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of tokens that lets nobody in.
    #[error("{}: holds no token, so nobody could ask; add one, or the line `nobody` if that is meant", path.display())]
    NoTokens {
        /// Which file.
        path: PathBuf,
    },
    /// A line of the file of tokens is not one. The line itself is not repeated: it may hold a secret.
    #[error("{}, line {line}: {reason}", path.display())]
    Tokens {
        /// Which file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Certificate or key cannot be used.
    #[error("{}: {reason}; a PEM file with the certificate chain and one with its private key are needed", path.display())]
    Tls {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Threads or signal handlers could not be had.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was asked for.
        what: &'static str,
        /// What it said.
        source: std::io::Error,
    },
}
