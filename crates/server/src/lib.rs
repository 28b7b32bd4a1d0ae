//! The service: sealed queries in over HTTP, poses out, on a network one does not trust.
//!
//! - [`ServerOptions`]: what to serve, to whom, how much at a time.
//! - [`Server`]: bound to its address with all maps open; [`Server::run`] answers until it is told to stop.
//! - [`run_until_signal`]: the same for a program that is nothing but the service.
//!
//! # How a request goes
//! Who asks is checked first, then how often, then what is sent, and only then is anything computed: a request that is
//! refused costs nearly nothing. Localization is work for the processor, so it is done by a fixed number of threads
//! behind a queue of fixed length (`pool.rs`); a full queue is told at once and with the time to come back.
//!
//! # What is never told
//! **Invariant, tested in `tests/privacy.rs`:** no log line, metric, or error holds anything of a query's content
//! (rule L8 of `docs/privacy.md`). Log lines are made in `routes/record.rs` alone, from names the operator chose, status
//! and times. And this crate depends neither on `veiloc-features` nor on `veiloc-obfuscation` (`cargo xtask tidy`).
#![forbid(unsafe_code)]

mod answer;
mod connection;
mod error;
mod geo;
mod maps;
mod metrics;
mod options;
mod panics;
mod pool;
mod problem;
mod routes;
mod serve;
mod signals;
mod state;
mod tls;
mod tokens;
mod watch;

pub use answer::{AnswerDocument, ConfidenceDocument, DoubtDocument, PoseDocument, StageDocument};
pub use error::ServerError;
pub use geo::{BadGeoFrame, GeoAccuracy, GeoFrame, GeoPoseDocument, GeoPosition, GeoQuaternion};
pub use options::{MapSource, RateLimit, ServerOptions, Timeouts, TlsFiles};
pub use problem::ProblemDocument;
pub use routes::openapi_json;
pub use serve::{Server, ServerHandle};
pub use signals::run_until_signal;
