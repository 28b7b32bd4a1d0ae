//! Metrics of the service in the text format of Prometheus (OpenMetrics).
//!
//! Labels are names that the operator chose, routes, status codes and names of problems. So their number is bounded
//! and none of them contains anything of a query. Series that alerts may use exist from the start, at zero: if a
//! counter appears with its first event, Prometheus misses that event.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use crate::auth::Timestamp;
use crate::telemetry::gateway::{GatewayCounts, RegionCounts};
use crate::telemetry::log::LogQueue;
use crate::telemetry::process::Process;
use crate::telemetry::request_context::RequestKind;

type Labels = Vec<(&'static str, Cow<'static, str>)>;

/// Buckets from a millisecond to half a minute, about three per decade.
const SECONDS: [f64; 14] = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0];

/// Number of token names with their own label; later names are counted together as [`OTHER`].
const TOKENS: usize = 256;

/// Label of all token names beyond the first [`TOKENS`].
const OTHER: &str = "other";

/// Stages of a request, see [`crate::telemetry::RequestStage`].
const STAGES: [&str; 6] = ["read", "queue", "retrieve", "match", "pose", "hold"];

/// How a localization ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LocalizationOutcome {
    /// A pose without doubts.
    Trusted,
    /// A pose with doubts.
    Doubtful,
    /// No pose.
    NotLocalized,
}

impl LocalizationOutcome {
    const ALL: [Self; 3] = [Self::Trusted, Self::Doubtful, Self::NotLocalized];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::NotLocalized => "not-localized",
        }
    }
}

/// Why a connection ended abnormally, below the level of requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ConnectionFault {
    /// The TLS handshake failed, or the client aborted it.
    TlsHandshake,
    /// The TLS handshake timed out.
    TlsTimeout,
    /// The input was not HTTP; answered with 400 where possible.
    NotHttp,
    /// The head or the address was too long; answered with 431 or 414.
    HeadTooLong,
    /// The head did not arrive in time.
    HeadTimeout,
    /// The client disconnected in the middle of a request.
    Interrupted,
    /// The client did not read its answer in time.
    AnswerTimeout,
    /// The client disconnected before it was answered.
    Left,
}

impl ConnectionFault {
    const ALL: [Self; 8] = [
        Self::TlsHandshake,
        Self::TlsTimeout,
        Self::NotHttp,
        Self::HeadTooLong,
        Self::HeadTimeout,
        Self::Interrupted,
        Self::AnswerTimeout,
        Self::Left,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TlsHandshake => "tls-handshake",
            Self::TlsTimeout => "tls-timeout",
            Self::NotHttp => "not-http",
            Self::HeadTooLong => "head-too-long",
            Self::HeadTimeout => "head-timeout",
            Self::Interrupted => "interrupted",
            Self::AnswerTimeout => "answer-timeout",
            Self::Left => "left",
        }
    }
}

/// Facts that are known when the service starts.
#[derive(Debug, Default)]
pub struct MetricsOptions<'a> {
    /// Threads that localize.
    pub workers: usize,
    /// Capacity of the queue.
    pub queue: usize,
    /// Maximum number of open connections.
    pub connections: usize,
    /// The version of the program.
    pub version: &'static str,
    /// The log, if it uses a queue.
    pub log: Option<&'a LogQueue>,
    /// Metrics of a gateway, if workers hold maps.
    pub gateway: Option<&'a GatewayCounts>,
    /// Metrics of a worker, if it serves regions.
    pub regions: Option<&'a RegionCounts>,
    /// Kinds of requests whose series exist from the start.
    pub requests: &'a [RequestKind<'a>],
}

/// Values that are read at each scrape.
#[derive(Debug, Clone, Copy, Default)]
pub struct GaugeValues {
    /// Queued queries.
    pub queued: usize,
    /// Busy threads.
    pub busy: usize,
    /// Open connections.
    pub connections: usize,
    /// Whether queries are accepted.
    pub ready: bool,
}

/// All metrics of the service.
pub struct Metrics {
    registry: Registry,
    requests: Family<Labels, Counter>,
    request_seconds: Family<Labels, Histogram, fn() -> Histogram>,
    token_requests: Family<Labels, Counter>,
    tokens: Mutex<BTreeSet<Arc<str>>>,
    stages: Family<Labels, Histogram, fn() -> Histogram>,
    localizations: Family<Labels, Counter>,
    late_answers: Counter,
    reloads: Family<Labels, Counter>,
    failing: Family<Labels, Gauge>,
    checked: Family<Labels, Gauge>,
    queued: Gauge,
    busy: Gauge,
    connections: Gauge,
    ready: Gauge,
    certificate_ends: Gauge,
    connections_closed: Family<Labels, Counter>,
    faults: Family<Labels, Counter>,
}

impl fmt::Debug for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Metrics").finish_non_exhaustive()
    }
}

impl Metrics {
    /// All series that are known from the start, at zero.
    pub fn new(options: &MetricsOptions<'_>) -> Self {
        let mut all = Registry::default();
        all.register_collector(Box::new(Process));
        let registry = all.sub_registry_with_prefix("veiloc");
        let counter = |registry: &mut Registry, name: &str, help: &str| {
            let family: Family<Labels, Counter> = Family::default();
            registry.register(name, help, family.clone());
            family
        };
        let histogram = |registry: &mut Registry, name: &str, help: &str| {
            let new = (|| Histogram::new(SECONDS)) as fn() -> Histogram;
            let family: Family<Labels, Histogram, fn() -> Histogram> = Family::new_with_constructor(new);
            registry.register(name, help, family.clone());
            family
        };
        let gauge = |registry: &mut Registry, name: &str, help: &str, value: usize| {
            let gauge: Gauge = Gauge::default();
            gauge.set(value as i64);
            registry.register(name, help, gauge.clone());
            gauge
        };
        let build: Family<Labels, Gauge> = Family::default();
        build.get_or_create(&vec![("version", Cow::Borrowed(options.version))]).set(1);
        registry.register("build_info", "1; the label is what runs", build);
        let requests = counter(registry, "requests", "Requests answered, by route, status and problem");
        let request_seconds =
            histogram(registry, "request_seconds", "Time from the head of a request to its answer");
        let token_requests = counter(
            registry,
            "token_requests",
            "Requests with a known token, by its name and status; `other` for all but 256 names",
        );
        let stages = histogram(registry, "stage_seconds", "Time of each stage of a localization");
        let localizations = counter(registry, "localizations", "Localizations, by map and outcome");
        let late_answers = Counter::default();
        registry.register(
            "late_answers",
            "Answers about a pose that took more than one quantum of time",
            late_answers.clone(),
        );
        let reloads = counter(registry, "reloads", "Reloaded files, by kind and result");
        let failing: Family<Labels, Gauge> = Family::default();
        registry.register(
            "reload_failing",
            "1 while the newest version of a file cannot be used and an older one, or none, is in use",
            failing.clone(),
        );
        let checked: Family<Labels, Gauge> = Family::default();
        registry.register(
            "files_checked_timestamp_seconds",
            "When the files were last checked for changes, seconds since 1970",
            checked.clone(),
        );
        gauge(registry, "workers", "Threads that localize", options.workers);
        gauge(registry, "queue_capacity", "Queries that may wait for a worker", options.queue);
        gauge(registry, "connections_limit", "Connections that may be open", options.connections);
        let queued = gauge(registry, "queue_length", "Queries waiting for a worker", 0);
        let busy = gauge(registry, "workers_busy", "Threads localizing at the moment", 0);
        let connections = gauge(registry, "connections", "Open connections", 0);
        let ready = gauge(registry, "ready", "1 while queries are accepted, as /readyz says", 0);
        let certificate_ends = gauge(
            registry,
            "certificate_expiry_timestamp_seconds",
            "When the certificate ends, seconds since 1970; 0 without one",
            0,
        );
        let connections_closed = counter(
            registry,
            "connections_closed",
            "Connections closed by the limits: evicted (for a new one), or refused because all were busy",
        );
        let faults = counter(
            registry,
            "connection_faults",
            "Connections that ended abnormally below the level of requests, by kind",
        );
        if let Some(log) = options.log {
            registry.register(
                "log_lines_dropped",
                "Log lines that could not be written",
                log.dropped_counter(),
            );
        }
        if let Some(gateway) = options.gateway {
            gateway.register(registry);
        }
        if let Some(regions) = options.regions {
            regions.register(registry);
        }
        let metrics = Self {
            registry: all,
            requests,
            request_seconds,
            token_requests,
            tokens: Mutex::default(),
            stages,
            localizations,
            late_answers,
            reloads,
            failing,
            checked,
            queued,
            busy,
            connections,
            ready,
            certificate_ends,
            connections_closed,
            faults,
        };
        metrics.create_at_zero(options.requests);
        metrics
    }

    /// Creates series before their first event.
    fn create_at_zero(&self, requests: &[RequestKind<'_>]) {
        for kind in requests {
            drop(self.requests.get_or_create(&labels_of(kind)));
        }
        for stage in STAGES {
            drop(self.stages.get_or_create(&vec![("stage", Cow::Borrowed(stage))]));
        }
        for reason in ["evicted", "refused"] {
            drop(self.connections_closed.get_or_create(&vec![("reason", Cow::Borrowed(reason))]));
        }
        for fault in ConnectionFault::ALL {
            drop(self.faults.get_or_create(&vec![("kind", Cow::Borrowed(fault.name()))]));
        }
        for file in ["tokens", "certificate"] {
            self.register_file(file, "");
        }
    }

    fn register_file(&self, what: &'static str, name: &str) {
        for result in ["taken", "refused"] {
            drop(self.reloads.get_or_create(&reload_labels(what, name, result)));
        }
        drop(self.failing.get_or_create(&failing_labels(what, name)));
    }

    /// Adds the counter of spans that could not be sent.
    pub fn count_spans_of(&mut self, traces: &crate::telemetry::traces::Traces) {
        let registry = self.registry.sub_registry_with_prefix("veiloc");
        registry.register(
            "spans_dropped",
            "Spans of traces that could not be sent",
            traces.dropped_counter(),
        );
    }

    /// Creates the series of a map that is served or configured.
    pub fn register_map(&self, name: &str) {
        self.register_file("map", name);
        for outcome in LocalizationOutcome::ALL {
            drop(self.localizations.get_or_create(&localization_labels(name, outcome)));
        }
    }

    /// Records an answered request and its duration. `token`: name of the token of the request.
    pub fn request(&self, kind: &RequestKind<'_>, took: Duration, token: Option<&str>) {
        self.requests.get_or_create(&labels_of(kind)).inc();
        let status = Cow::<str>::Owned(kind.status.to_string());
        let labels = vec![("route", Cow::Owned(kind.route.to_owned())), ("status", status.clone())];
        self.request_seconds.get_or_create(&labels).observe(took.as_secs_f64());
        if let Some(token) = token {
            let labels = vec![("token", self.token_label(token)), ("status", status)];
            self.token_requests.get_or_create(&labels).inc();
        }
    }

    /// The label of a token, [`OTHER`] beyond [`TOKENS`] names.
    fn token_label(&self, name: &str) -> Cow<'static, str> {
        let mut known = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        if !known.contains(name) {
            if known.len() >= TOKENS {
                return Cow::Borrowed(OTHER);
            }
            known.insert(name.into());
        }
        Cow::Owned(name.to_owned())
    }

    /// `why`: `evicted` or `refused`.
    pub fn connection_closed(&self, why: &'static str) {
        self.connections_closed.get_or_create(&vec![("reason", Cow::Borrowed(why))]).inc();
    }

    /// Counts the fault of a connection.
    pub fn connection_fault(&self, fault: ConnectionFault) {
        self.faults.get_or_create(&vec![("kind", Cow::Borrowed(fault.name()))]).inc();
    }

    /// Counts an answer that took more than one quantum.
    pub fn late_answer(&self) {
        self.late_answers.inc();
    }

    /// Records the duration of a stage, see [`crate::telemetry::RequestStage`].
    pub fn stage(&self, stage: &'static str, time: Duration) {
        self.stages.get_or_create(&vec![("stage", Cow::Borrowed(stage))]).observe(time.as_secs_f64());
    }

    /// Counts a localization by map and outcome.
    pub fn localization(&self, map: &str, outcome: LocalizationOutcome) {
        self.localizations.get_or_create(&localization_labels(map, outcome)).inc();
    }

    /// `what`: `map` and its name, `tokens` or `certificate`.
    pub fn reload(&self, what: &'static str, name: &str, taken: bool) {
        let result = if taken { "taken" } else { "refused" };
        self.reloads.get_or_create(&reload_labels(what, name, result)).inc();
    }

    /// `what` as for [`Self::reload`], or `folder`.
    pub fn reload_failing(&self, what: &'static str, name: &str, failing: bool) {
        self.failing.get_or_create(&failing_labels(what, name)).set(failing.into());
    }

    /// Removes the failure gauge of a map that is no longer served.
    pub fn remove_map_gauge(&self, name: &str) {
        self.failing.remove(&failing_labels("map", name));
    }

    /// Notes that the `credentials` or the `maps` were just checked for changes. A check that never ends, for example on
    /// a network drive that is away, leaves the gauge behind.
    pub fn files_checked(&self, what: &'static str) {
        let now = Timestamp::of(SystemTime::now());
        self.checked.get_or_create(&vec![("files", Cow::Borrowed(what))]).set(now.unix());
    }

    /// Sets the end of the certificate, seconds since 1970.
    pub fn certificate_ends(&self, seconds: i64) {
        self.certificate_ends.set(seconds);
    }

    /// All metrics as text.
    pub fn text(&self, now: &GaugeValues) -> String {
        self.connections.set(now.connections as i64);
        self.queued.set(now.queued as i64);
        self.busy.set(now.busy as i64);
        self.ready.set(now.ready.into());
        let mut text = String::new();
        // Writing into a string cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}

fn labels_of(kind: &RequestKind<'_>) -> Labels {
    vec![
        ("route", Cow::Owned(kind.route.to_owned())),
        ("status", Cow::Owned(kind.status.to_string())),
        ("problem", Cow::Borrowed(kind.problem.unwrap_or(""))),
    ]
}

fn localization_labels(map: &str, outcome: LocalizationOutcome) -> Labels {
    vec![("map", Cow::Owned(map.to_owned())), ("outcome", Cow::Borrowed(outcome.name()))]
}

fn failing_labels(what: &'static str, name: &str) -> Labels {
    vec![("file", Cow::Borrowed(what)), ("map", Cow::Owned(name.to_owned()))]
}

fn reload_labels(what: &'static str, name: &str, result: &'static str) -> Labels {
    let mut labels = failing_labels(what, name);
    labels.push(("result", Cow::Borrowed(result)));
    labels
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics() -> Metrics {
        let kind = RequestKind { route: "/v1/maps", status: 500, problem: Some("broken") };
        Metrics::new(&MetricsOptions { version: "7.8.9", requests: &[kind], ..Default::default() })
    }

    #[test]
    fn metrics_exist_at_zero_from_the_start() {
        let metrics = metrics();
        metrics.register_map("lobby");
        let text = metrics.text(&GaugeValues { ready: true, ..GaugeValues::default() });
        for line in [
            r#"veiloc_requests_total{route="/v1/maps",status="500",problem="broken"} 0"#,
            r#"veiloc_connection_faults_total{kind="tls-handshake"} 0"#,
            r#"veiloc_connections_closed_total{reason="refused"} 0"#,
            r#"veiloc_localizations_total{map="lobby",outcome="trusted"} 0"#,
            r#"veiloc_reload_failing{file="map",map="lobby"} 0"#,
            r#"veiloc_stage_seconds_count{stage="pose"} 0"#,
            r#"veiloc_build_info{version="7.8.9"} 1"#,
            "veiloc_ready 1",
        ] {
            assert!(text.lines().any(|l| l == line), "{line}\n{text}");
        }
        metrics.remove_map_gauge("lobby");
        assert!(!metrics.text(&GaugeValues::default()).contains("veiloc_reload_failing{file=\"map\""));
        if cfg!(target_os = "linux") {
            assert!(
                text.contains("\nprocess_resident_memory_bytes ")
                    && text.contains("\nprocess_cpu_seconds_total "),
                "{text}"
            );
        }
    }

    /// The number of series is bounded for any number of token names, and every request is counted.
    #[test]
    fn number_of_token_labels_is_bounded() {
        let metrics = metrics();
        let kind = RequestKind { route: "/v1/maps", status: 422, problem: Some("not-localized") };
        for round in 0..2 {
            for i in 0..TOKENS + 50 {
                metrics.request(&kind, Duration::from_millis(30), Some(&format!("phone-{i}")));
            }
            let text = metrics.text(&GaugeValues::default());
            let lines: Vec<_> =
                text.lines().filter(|l| l.starts_with("veiloc_token_requests_total{")).collect();
            assert_eq!(lines.len(), TOKENS + 1);
            let other =
                format!(r#"veiloc_token_requests_total{{token="other",status="422"}} {}"#, 50 * (round + 1));
            assert!(lines.contains(&other.as_str()), "{lines:?}");
        }
        let text = metrics.text(&GaugeValues::default());
        let counted =
            format!(r#"veiloc_request_seconds_count{{route="/v1/maps",status="422"}} {}"#, 2 * (TOKENS + 50));
        assert!(text.contains(&counted), "{text}");
        let below = r#"veiloc_request_seconds_bucket{le="0.02",route="/v1/maps",status="422"} 0"#;
        assert!(text.contains(below), "{text}");
    }

    #[test]
    fn fault_names_are_unique() {
        let names: BTreeSet<_> = ConnectionFault::ALL.iter().map(|fault| fault.name()).collect();
        assert_eq!(names.len(), ConnectionFault::ALL.len());
    }
}
