//! Internal: the service, which accepts sealed queries over HTTP and returns poses, on an untrusted network.
//!
//! - [`ServerOptions`]: which maps to serve, who may query them, and limits.
//! - [`Server`]: bound to its addresses with all maps open; [`Server::run`] serves until it is stopped.
//! - [`run_until_signal`]: the same for a program that only runs the service.
//!
//! This crate is for programs that embed the service; `veiloc serve` is the ready program, and `docs/reference/http.md`
//! describes addresses, answers and refusals. The client side is `veiloc-client`.
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
//! The service checks first the token, then the rate limit, then the size and form of the request, and only then
//! computes: a refused request costs almost nothing. Localization is bound by the processor, so a fixed number of
//! threads does it, each job on one thread, behind a fair queue of bounded length (`queue`). A request that
//! does not fit into the queue, or would not finish in time, is refused at once with `Retry-After`.
//!
//! # What is never logged
//! **Invariant, tested in `tests/it/privacy.rs`:** no log line, metric or error contains any content of a query (rule
//! L8 of `docs/reference/privacy-rules.md`). `routes/record.rs` writes the log lines of requests from names that the operator chose,
//! the request id of the server, status and durations. For a panic only the location is logged (`telemetry/panics.rs`); for
//! threads of the service, the panic message is discarded. This crate depends neither on `veiloc-features` nor on
//! `veiloc-obfuscation` (`cargo xtask tidy`).
#![forbid(unsafe_code)]

pub mod auth;
mod error;
pub mod http;
mod maps;
mod options;
pub mod queue;
mod routes;
mod serve;
pub mod telemetry;
pub mod web_page;

pub use crate::http::{ListenAddress, TlsFiles};
pub use crate::telemetry::{LogLine, LogQueue};
pub use error::ServerError;
pub use http::origin::{CorsOrigin, InvalidOrigin};
pub use http::problem::ProblemDocument;
pub use maps::geo_reference::GeoReference;
pub use maps::regions::{OpenRegion, RegionFailure, RegionFuture, RegionSource, Regions};
pub use maps::remote::{AnswerFuture, MapDescription, RemoteBackend, RemoteMap, RemoteRequest};
pub use options::{MapSource, RateLimit, ServerOptions, Timeouts};
pub use queue::clock::{Clock, Gate};
pub use routes::decoded_request::{BodyKind, DecodedRequest, LocalizeFailure, NoPose};
pub use routes::openapi_json;
pub use serve::signals::{run_prepared, run_until_signal};
pub use serve::{Listening, Server, ServerHandle, ShutdownSummary};
