//! The service: sealed queries in over HTTP, poses out, on a network one does not trust.
//!
//! - [`ServerOptions`]: what to serve, to whom, how much at a time.
//! - [`Server`]: bound to its addresses with all maps open; [`Server::run`] answers until it is told to stop.
//! - [`run_until_signal`]: the same for a program that is nothing but the service.
//!
//! This crate is for whoever builds a service into a program of their own; `veiloc serve` is the program for all others,
//! and `docs/reference/http.md` describes addresses, answers and refusals. A device's side is `veiloc-client`.
//!
//! ```
//! use std::io::{Read, Write};
//! use veiloc_service::{MapSource, Server, ServerOptions};
//!
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("lobby.vmap");
//! # let words = veiloc_descriptor::Descriptors::new(veiloc_descriptor::DescriptorKind::ROOT_SIFT, vec![9; 512])?;
//! # let profile = veiloc_protocol::Profile::vlad(veiloc_descriptor::Vocabulary::new(words)?);
//! # veiloc_map::write(&veiloc_map::MapModel::empty(profile, Default::default()), &path)?;
//! let mut options = ServerOptions::new(vec![MapSource { name: "lobby".to_owned(), path }]);
//! options.listen = vec!["127.0.0.1:0".parse()?];
//! let runtime = tokio::runtime::Runtime::new()?;
//! let server = runtime.block_on(Server::bind(options))?;
//! let (address, handle) = (server.address().expect("a TCP listener"), server.handle());
//! let running = runtime.spawn(server.run());
//!
//! let mut stream = std::net::TcpStream::connect(address)?;
//! stream.write_all(b"GET /readyz HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n")?;
//! let mut reply = String::new();
//! stream.read_to_string(&mut reply)?;
//! assert!(reply.starts_with("HTTP/1.1 200 OK") && reply.ends_with("ready\n"));
//!
//! handle.stop();
//! assert_eq!(runtime.block_on(running)?.given_up, 0, "connections that had to be given up");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How a request goes
//! Who asks is checked first, then how often, then what is sent, and only then is anything computed: a request that is
//! refused costs nearly nothing. Localization is work for the processor, so it is done by a fixed number of threads
//! behind a fair queue of fixed length (`pool.rs`, `veiloc_service::queue`); what does not fit, or would not be done in time, is told at once
//! and with the time to come back.
//!
//! # What is never told
//! **Invariant, tested in `tests/privacy.rs`:** no log line, metric, or error holds anything of a query's content
//! (rule L8 of `docs/reference/privacy-rules.md`). Log lines of requests are made in `routes/record.rs`, from names the operator chose, the
//! server's own name for the request, status and times; of a panic the place is logged (`panics.rs`), what it said goes nowhere for threads of the service. In a
//! program that is more than the service, a panic in a thread of rayon's pool, which localization uses for a part of its
//! work, also reaches that program's own panic hook. And this crate depends neither on `veiloc-features` nor on `veiloc-obfuscation` (`cargo xtask tidy`).
#![forbid(unsafe_code)]

mod admin;
mod answer;
mod asked;
pub mod auth;
mod clock;
mod cors;
mod descriptors;
mod elsewhere;
mod error;
pub mod http;
mod maps;
mod options;
mod origin;
mod padding;
mod panics;
mod pool;
mod problem;
pub mod queue;
mod reload;
mod routes;
mod serve;
mod signals;
mod state;
pub mod telemetry;
mod tokens;
mod tokens_file;
mod watch;
pub mod web_page;

/// For programs that localize without HTTP, as the workers of a cluster do: the same threads, the same silence about
/// panics, the same answers to probes and signals.
pub mod labour {
    pub use crate::admin::{Probed, probes};
    pub use crate::panics::{during, mark, own_process};
    pub use crate::pool::{Order, Pool, Refused};
    pub use crate::signals::{Signals, Told};
}

pub use crate::http::{ListenAddress, TlsFiles};
pub use crate::telemetry::{LogLine, LogQueue};
pub use asked::{Asked, Found, Kind, NoPose, Unanswered};
pub use clock::Clock;
pub use elsewhere::{Answering, Description, Elsewhere, MapElsewhere, Question};
pub use error::ServerError;
pub use options::{MapSource, RateLimit, ServerOptions, Timeouts};
pub use origin::{BadOrigin, Origin};
pub use problem::ProblemDocument;
pub use routes::openapi_json;
pub use serve::{Listening, Server, ServerHandle, Stopped};
pub use signals::{run_prepared, run_until_signal};
