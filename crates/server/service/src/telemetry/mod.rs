//! What an operator sees of the service, without a word about the protocol it speaks or about localization.
//!
//! - [`RequestId`]: a name for each request, drawn by the server; in the answer, the log and the trace.
//! - [`Trail`]: what is known of a request on its way, for its log line and its trace.
//! - [`Metrics`]: counts and times in the text format of Prometheus, those of the process included.
//! - [`GatewayCounts`], [`WorkerCounts`]: the same of a cluster's machines.
//! - [`LogQueue`]: log lines that hold up nobody.
//! - `Traces`, with the cargo feature `opentelemetry`: spans of each request to a collector.
//!
//! Nothing here takes anything of a query: labels, fields and names are those that the operator chose, routes, statuses,
//! names of problems, times and counts (rule L8 of `docs/reference/privacy-rules.md`). `veiloc-service` is the user.
//!
//! ```
//! use veiloc_service::telemetry::{MetricsOptions, Metrics, RequestIds};
//!
//! let ids = RequestIds::start()?;
//! assert_ne!(ids.next(), ids.next());
//! let metrics = Metrics::new(&MetricsOptions { workers: 2, queue: 32, connections: 1024, ..Default::default() });
//! assert!(metrics.text(&Default::default()).contains("veiloc_workers 2\n"));
//! # Ok::<(), std::io::Error>(())
//! ```
#![forbid(unsafe_code)]

mod cluster;
mod log;
mod metrics;
mod process;
mod request_id;
#[cfg(feature = "opentelemetry")]
mod traces;
mod trail;
mod waiting;

pub use cluster::{GatewayCounts, WorkerCounts, WorkerNow};
pub use log::{LogLine, LogQueue};
pub use metrics::{ConnectionFault, Metrics, MetricsOptions, Now, Outcome};
pub use request_id::{RequestId, RequestIds};
#[cfg(feature = "opentelemetry")]
pub use traces::Traces;
pub use trail::{RequestKind, Stage, Trail};
