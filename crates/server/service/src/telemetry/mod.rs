//! Logs, metrics and traces, independent of the protocol and of localization.
//!
//! - [`RequestId`]: an id for each request, drawn by the server; it appears in the answer, the log and the trace.
//! - [`RequestContext`]: data about a request in progress, for its log line and its trace.
//! - [`Metrics`]: metrics in the text format of Prometheus, those of the process included.
//! - [`GatewayCounts`], [`RegionCounts`]: metrics of gateways and of workers.
//! - [`LogQueue`]: log lines that never block their caller.
//! - [`Traces`]: spans of each request for a collector. A request to another machine is an [`OpenCall`].
//!
//! Nothing here receives any content of a query: labels, fields and names are names that the operator chose, routes,
//! statuses, names of problems, durations and counts (rule L8 of `docs/reference/privacy-rules.md`).
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

mod background_queue;
mod gateway;
mod log;
mod metrics;
pub(crate) mod panics;
mod process;
mod request_context;
mod request_id;
mod traces;

pub use gateway::{GatewayCounts, RegionCounts};
pub use log::{LogLine, LogQueue};
pub use metrics::{ConnectionFault, GaugeValues, LocalizationOutcome, Metrics, MetricsOptions};
pub use request_context::{OpenCall, RemoteCall, RequestContext, RequestKind, RequestStage};
pub use request_id::{RequestId, RequestIds, SpanId};
pub use traces::Traces;
