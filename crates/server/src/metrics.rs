//! What the operator may watch, in the text format of Prometheus.
//!
//! Labels are names the operator chose, routes, status codes and names of problems, so their number is bounded and
//! none of them holds anything of a query.

use std::borrow::Cow;
use std::time::Duration;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;
use veiloc_localize::StageTimes;

use crate::log::LogQueue;

type Labels = Vec<(&'static str, Cow<'static, str>)>;

/// From a millisecond to half a minute, about three a decade.
const SECONDS: [f64; 14] = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0];

/// How a localization ended.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Outcome {
    Trusted,
    Doubtful,
    NotLocalized,
}

pub(crate) struct Metrics {
    registry: Registry,
    requests: Family<Labels, Counter>,
    stages: Family<Labels, Histogram, fn() -> Histogram>,
    localizations: Family<Labels, Counter>,
    reloads: Family<Labels, Counter>,
    failing: Family<Labels, Gauge>,
    queued: Gauge,
    busy: Gauge,
    connections: Gauge,
    certificate_ends: Gauge,
    connections_closed: Family<Labels, Counter>,
}

impl Metrics {
    pub(crate) fn new(workers: usize, queue: usize, log: Option<&LogQueue>) -> Self {
        let mut registry = Registry::with_prefix("veiloc");
        let requests = Family::default();
        registry.register("requests", "Requests answered, by route, status and problem", requests.clone());
        let stages = Family::new_with_constructor((|| Histogram::new(SECONDS)) as fn() -> Histogram);
        registry.register("stage_seconds", "Time of each stage of a localization", stages.clone());
        let localizations = Family::default();
        registry.register("localizations", "Localizations, by map and outcome", localizations.clone());
        let reloads = Family::default();
        registry.register(
            "reloads",
            "Files read again, by what they hold and whether it was taken",
            reloads.clone(),
        );
        let failing = Family::default();
        registry.register(
            "reload_failing",
            "1 while the newest state of a file cannot be used and an older one, or none, is",
            failing.clone(),
        );
        let gauge = |registry: &mut Registry, name: &str, help: &str, value: usize| {
            let gauge: Gauge = Gauge::default();
            gauge.set(value as i64);
            registry.register(name, help, gauge.clone());
            gauge
        };
        gauge(&mut registry, "workers", "Threads that localize", workers);
        gauge(&mut registry, "queue_capacity", "Queries that may wait for a worker", queue);
        let queued = gauge(&mut registry, "queue_length", "Queries waiting for a worker", 0);
        let busy = gauge(&mut registry, "workers_busy", "Threads localizing at the moment", 0);
        let connections = gauge(&mut registry, "connections", "Open connections", 0);
        let certificate_ends = gauge(
            &mut registry,
            "certificate_expiry_timestamp_seconds",
            "When the certificate ends, seconds since 1970; 0 without one",
            0,
        );
        let connections_closed = Family::default();
        registry.register(
            "connections_closed",
            "Connections closed for others: displaced by a newcomer, or refused because all were busy",
            connections_closed.clone(),
        );
        if let Some(log) = log {
            registry.register(
                "log_lines_dropped",
                "Log lines that could not be written",
                log.dropped_counter(),
            );
        }
        Self {
            registry,
            requests,
            stages,
            localizations,
            reloads,
            failing,
            queued,
            busy,
            connections,
            certificate_ends,
            connections_closed,
        }
    }

    pub(crate) fn request(&self, route: &str, status: u16, problem: Option<&'static str>) {
        let labels = vec![
            ("route", Cow::Owned(route.to_owned())),
            ("status", Cow::Owned(status.to_string())),
            ("problem", Cow::Borrowed(problem.unwrap_or(""))),
        ];
        self.requests.get_or_create(&labels).inc();
    }

    /// `why`: `displaced` or `refused`.
    pub(crate) fn connection_closed(&self, why: &'static str) {
        self.connections_closed.get_or_create(&vec![("reason", Cow::Borrowed(why))]).inc();
    }

    pub(crate) fn stage(&self, stage: &'static str, time: Duration) {
        self.stages.get_or_create(&vec![("stage", Cow::Borrowed(stage))]).observe(time.as_secs_f64());
    }

    pub(crate) fn localization(&self, map: &str, outcome: Outcome, times: Option<&StageTimes>) {
        let outcome = match outcome {
            Outcome::Trusted => "trusted",
            Outcome::Doubtful => "doubtful",
            Outcome::NotLocalized => "not-localized",
        };
        let labels = vec![("map", Cow::Owned(map.to_owned())), ("outcome", Cow::Borrowed(outcome))];
        self.localizations.get_or_create(&labels).inc();
        for (stage, ms) in times
            .into_iter()
            .flat_map(|t| [("retrieve", t.retrieve_ms), ("match", t.match_ms), ("pose", t.pose_ms)])
        {
            self.stage(stage, Duration::from_secs_f64(ms.max(0.0) / 1e3));
        }
    }

    /// `what`: `map` and its name, `tokens` or `certificate`.
    pub(crate) fn reload(&self, what: &'static str, name: &str, taken: bool) {
        let labels = vec![
            ("file", Cow::Borrowed(what)),
            ("map", Cow::Owned(name.to_owned())),
            ("result", Cow::Borrowed(if taken { "taken" } else { "refused" })),
        ];
        self.reloads.get_or_create(&labels).inc();
    }

    /// `what` as for [`Self::reload`], or `folder`.
    pub(crate) fn reload_failing(&self, what: &'static str, name: &str, failing: bool) {
        let labels = vec![("file", Cow::Borrowed(what)), ("map", Cow::Owned(name.to_owned()))];
        self.failing.get_or_create(&labels).set(failing.into());
    }

    /// A map that is served no more fails no more.
    pub(crate) fn forget_map(&self, name: &str) {
        self.failing.remove(&vec![("file", Cow::Borrowed("map")), ("map", Cow::Owned(name.to_owned()))]);
    }

    /// Seconds since 1970.
    pub(crate) fn certificate_ends(&self, seconds: i64) {
        self.certificate_ends.set(seconds);
    }

    /// All of it; the counts of pool and connections are read now.
    pub(crate) fn text(&self, queued: usize, busy: usize, connections: usize) -> String {
        self.connections.set(connections as i64);
        self.queued.set(queued as i64);
        self.busy.set(busy as i64);
        let mut text = String::new();
        // Writing into a string cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}
