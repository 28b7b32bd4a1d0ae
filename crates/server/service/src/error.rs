//! Why the service could not start or go on, with the remedy.

use std::path::PathBuf;

use crate::http::{ListenAddress, ListenError, TlsError};
use veiloc_map::MapError;

/// Why the service could not start, or a file it needs could not be read or written.
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
        listen: ListenAddress,
    },
    /// No tokens where negatives can ask.
    #[error(
        "everybody who reaches {listen} could ask; give a file of tokens, or say that this is meant with \
         --allow-anonymous"
    )]
    Anonymous {
        /// Where it was to listen.
        listen: ListenAddress,
    },
    /// Nowhere to listen.
    #[error("nowhere to listen; give at least one address")]
    NoListener,
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
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of tokens with a line that is none, or without any token.
    #[error("{}: {source}", path.display())]
    Tokens {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it; the line itself is not repeated, as it may hold a secret.
        source: crate::auth::TokensError,
    },
    /// Traces cannot be sent there.
    #[error("traces cannot be sent: {source}")]
    Collector {
        /// Why.
        source: std::io::Error,
    },
    /// Certificate, key or the authorities of clients cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// Clients are to show certificates, where none can be asked for.
    #[error(
        "clients show certificates over TLS alone; give the service a certificate and its key (--cert, --key)"
    )]
    ClientsWithoutTls,
    /// Threads or signal handlers could not be had.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was asked for.
        what: &'static str,
        /// What it said.
        source: std::io::Error,
    },
    /// The page is not where it is looked for.
    #[error(
        "the page is neither in {} nor in {}; build it with bindings/web/build.sh, or say where it is with \
         --page-folder (the npm package has it in node_modules/veiloc/page)",
        beside.display(), shared.display()
    )]
    NoPage {
        /// Beside the program.
        beside: PathBuf,
        /// Where packages put it.
        shared: PathBuf,
    },
    /// A folder that is no page.
    #[error("{}: {missing} is missing, so this is no built page; build it with bindings/web/build.sh", path.display())]
    PageIncomplete {
        /// The folder.
        path: PathBuf,
        /// What is not there.
        missing: &'static str,
    },
    /// A folder larger than any page.
    #[error("{}: larger than any page, 64 MiB; give the folder that bindings/web/build.sh makes", path.display())]
    PageTooLarge {
        /// The folder.
        path: PathBuf,
    },
    /// A name that is no file's of a page.
    #[error("{name:?} is no file of a page: letters, digits, `-`, `_` and `.`, with a known ending")]
    PageName {
        /// It.
        name: String,
    },
}
