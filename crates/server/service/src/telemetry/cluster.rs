//! Metrics of a cluster: of gateways and of workers.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use crate::telemetry::process::Process;

type Labels = Vec<(&'static str, &'static str)>;
type MapLabels = Vec<(&'static str, String)>;

/// Buckets from 0.1 ms to 10 s.
const SECONDS: [f64; 15] =
    [0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0];

/// Outcomes of a message to a worker, as the gateway sees them.
const MESSAGE_OUTCOMES: [&str; 6] =
    ["answered", "no-subscriber", "rejected", "no-reply", "invalid-reply", "superseded"];

/// Kinds of requests to a worker.
const REQUEST_KINDS: [&str; 3] = ["ping", "search", "pose"];

/// Outcomes of a request, as the worker sees them.
const REPLY_OUTCOMES: [&str; 6] = ["answered", "no-pose", "busy", "duplicate", "rejected", "internal-error"];

/// State of a request when it was cancelled.
const CANCEL_STAGES: [&str; 2] = ["queued", "running"];

/// Metrics of a gateway; clones share the values.
#[derive(Clone)]
pub struct GatewayCounts {
    messages: Family<Labels, Counter>,
    hedges: Counter,
    round_trips: Histogram,
    regions: Histogram,
    manifests: Counter,
    copies: Family<MapLabels, Gauge>,
    complete: Family<MapLabels, Gauge>,
    members: Family<MapLabels, Gauge>,
    gateways: Family<Labels, Gauge>,
    peer_requests: Counter,
}

impl Default for GatewayCounts {
    fn default() -> Self {
        let counts = Self {
            messages: Family::default(),
            hedges: Counter::default(),
            round_trips: Histogram::new(SECONDS),
            regions: Histogram::new([1.0, 2.0, 3.0, 4.0, 6.0, 8.0]),
            manifests: Counter::default(),
            copies: Family::default(),
            complete: Family::default(),
            members: Family::default(),
            gateways: Family::default(),
            peer_requests: Counter::default(),
        };
        counts.gateways(0, 0);
        for end in MESSAGE_OUTCOMES {
            drop(counts.messages.get_or_create(&vec![("outcome", end)]));
        }
        counts
    }
}

impl GatewayCounts {
    /// Counts a message to a worker by its outcome.
    pub fn message(&self, end: &'static str) {
        self.messages.get_or_create(&vec![("outcome", end)]).inc();
    }

    /// Counts a hedged request: the same bytes were sent again before the first answer.
    pub fn hedged(&self) {
        self.hedges.inc();
    }

    /// Records the transport time of a message: round trip without queue and work.
    pub fn round_trip(&self, took: Duration) {
        self.round_trips.observe(took.as_secs_f64());
    }

    /// Records the number of regions in which a query was searched.
    pub fn regions_searched(&self, count: usize) {
        self.regions.observe(count as f64);
    }

    /// Counts an activated manifest.
    pub fn manifest_activated(&self) {
        self.manifests.inc();
    }

    /// Sets the number of workers that hold the region of a map that fewest hold; 0 before its first manifest is active.
    pub fn copies(&self, map: &str, least: usize) {
        let label = vec![("map", map.to_owned())];
        self.copies.get_or_create(&label).set(least as i64);
        self.complete.get_or_create(&label).set((least > 0).into());
    }

    /// Sets the numbers of workers of a map that answer, that are out, and whose version has no frames in common with ours.
    pub fn members(&self, map: &str, answering: usize, out: usize, foreign: usize) {
        for (state, count) in [("answering", answering), ("out", out), ("version", foreign)] {
            let labels = vec![("map", map.to_owned()), ("state", state.to_owned())];
            self.members.get_or_create(&labels).set(count as i64);
        }
    }

    /// Sets the numbers of other gateways that report what their clients spend, and that no longer do and have not left.
    pub fn gateways(&self, reporting: usize, silent: usize) {
        for (state, count) in [("reporting", reporting), ("silent", silent)] {
            self.gateways.get_or_create(&vec![("state", state)]).set(count as i64);
        }
    }

    /// Counts requests that another gateway accepted, and that were taken from the rate limits here.
    pub fn peer_requests(&self, requests: u32) {
        self.peer_requests.inc_by(requests.into());
    }

    pub(crate) fn register(&self, registry: &mut Registry) {
        let registry = registry.sub_registry_with_prefix("cluster");
        registry.register("messages", "Messages to workers, by how they ended", self.messages.clone());
        registry.register(
            "hedges",
            "Hedged requests: messages sent again before an answer",
            self.hedges.clone(),
        );
        registry.register(
            "round_trip_seconds",
            "Round trip to a worker without queue and work",
            self.round_trips.clone(),
        );
        registry.register("regions", "Regions in which a query was searched", self.regions.clone());
        registry.register("manifests", "Activated manifests", self.manifests.clone());
        let help = "Workers that hold the region of the active manifest that fewest hold";
        registry.register("copies", help, self.copies.clone());
        let help = "1 while every region of the active manifest has a worker";
        registry.register("complete", help, self.complete.clone());
        registry.register("members", "Workers of the map, by state", self.members.clone());
        let help = "Other gateways that report what their clients spend, by state";
        registry.register("gateways", help, self.gateways.clone());
        let help = "Requests that other gateways accepted, taken from the rate limits of this one";
        registry.register("peer_requests", help, self.peer_requests.clone());
    }
}

impl fmt::Debug for GatewayCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GatewayCounts").finish_non_exhaustive()
    }
}

/// Values of a worker that are read at each scrape.
#[derive(Debug, Clone, Copy, Default)]
pub struct WorkerGauges {
    /// Queued requests.
    pub queued: usize,
    /// Busy threads.
    pub busy: usize,
    /// Loaded regions and indexes.
    pub held: usize,
    /// Whether the worker is ready.
    pub ready: bool,
}

/// Metrics of a worker, with the registry that a scrape reads.
pub struct WorkerCounts {
    registry: Registry,
    requests: Family<Labels, Counter>,
    replies: Family<Labels, Counter>,
    cancelled: Family<Labels, Counter>,
    busy_seconds: Counter<f64, AtomicU64>,
    failing: Gauge,
    missing: Gauge,
    unplaced: Gauge,
    loads: Counter,
    now: [Gauge; 4],
}

impl WorkerCounts {
    /// All metrics at zero, for this number of threads and queue slots.
    pub fn new(version: &'static str, workers: usize, queue: usize) -> Arc<Self> {
        let mut all = Registry::default();
        all.register_collector(Box::new(Process));
        let registry = all.sub_registry_with_prefix("veiloc");
        let gauge = |registry: &mut Registry, name: &str, help: &str, value: usize| {
            let gauge: Gauge = Gauge::default();
            gauge.set(value as i64);
            registry.register(name, help, gauge.clone());
            gauge
        };
        let build: Family<Labels, Gauge> = Family::default();
        build.get_or_create(&vec![("version", version)]).set(1);
        registry.register("build_info", "1; the label is what runs", build);
        gauge(registry, "workers", "Threads that localize", workers);
        gauge(registry, "queue_capacity", "Requests that may wait for a thread", queue);
        let queued = gauge(registry, "queue_length", "Requests waiting for a thread", 0);
        let busy = gauge(registry, "workers_busy", "Threads localizing at the moment", 0);
        let held = gauge(registry, "objects_loaded", "Regions and indexes in memory", 0);
        let ready = gauge(registry, "ready", "1 while the worker is ready, as /readyz says", 0);
        let failing = gauge(
            registry,
            "reload_failing",
            "1 while the newest manifest cannot be read, or an object of it cannot be loaded",
            0,
        );
        let help = "Objects of the share of this worker that cannot be loaded";
        let missing = gauge(registry, "objects_missing", help, 0);
        let help = "Copies of regions for which no worker has space (--max-regions)";
        let unplaced = gauge(registry, "copies_unplaced", help, 0);
        let loads = Counter::default();
        registry.register("object_loads", "Regions and indexes that were loaded", loads.clone());
        let family = |registry: &mut Registry,
                      name: &str,
                      help: &str,
                      label: &'static str,
                      values: &[&'static str]| {
            let family: Family<Labels, Counter> = Family::default();
            for value in values {
                drop(family.get_or_create(&vec![(label, *value)]));
            }
            registry.register(name, help, family.clone());
            family
        };
        let requests =
            family(registry, "worker_requests", "Requests of gateways, by kind", "kind", &REQUEST_KINDS);
        let replies =
            family(registry, "worker_replies", "Replies to gateways, by outcome", "outcome", &REPLY_OUTCOMES);
        let help = "Cancelled requests, by state";
        let cancelled = family(registry, "worker_cancellations", help, "state", &CANCEL_STAGES);
        let busy_seconds: Counter<f64, AtomicU64> = Counter::default();
        registry.register("busy_seconds", "Total busy time of the threads", busy_seconds.clone());
        let now = [queued, busy, held, ready];
        Arc::new(Self {
            registry: all,
            requests,
            replies,
            cancelled,
            busy_seconds,
            failing,
            missing,
            unplaced,
            loads,
            now,
        })
    }

    /// Counts a request by its kind.
    pub fn request(&self, kind: &'static str) {
        self.requests.get_or_create(&vec![("kind", kind)]).inc();
    }

    /// Counts a reply by its outcome.
    pub fn reply(&self, outcome: &'static str) {
        self.replies.get_or_create(&vec![("outcome", outcome)]).inc();
    }

    /// Counts a cancelled request by its state: `queued` or `running`.
    pub fn cancelled(&self, state: &'static str) {
        self.cancelled.get_or_create(&vec![("state", state)]).inc();
    }

    /// Adds the busy time of a thread.
    pub fn add_busy_time(&self, took: Duration) {
        self.busy_seconds.inc_by(took.as_secs_f64());
    }

    /// Sets whether the newest manifest cannot be activated.
    pub fn set_activation_failing(&self, failing: bool) {
        self.failing.set(failing.into());
    }

    /// Sets the number of objects that cannot be loaded.
    pub fn set_missing(&self, objects: usize) {
        self.missing.set(objects as i64);
    }

    /// Sets the number of copies of regions for which no worker has space.
    pub fn set_unplaced(&self, copies: usize) {
        self.unplaced.set(copies as i64);
    }

    /// Counts an object that was loaded.
    pub fn loaded(&self) {
        self.loads.inc();
    }

    /// All metrics in the text format of Prometheus.
    pub fn text(&self, now: &WorkerGauges) -> String {
        let values = [now.queued as i64, now.busy as i64, now.held as i64, now.ready.into()];
        for (gauge, value) in self.now.iter().zip(values) {
            gauge.set(value);
        }
        let mut text = String::new();
        // Writing into a string cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}

impl fmt::Debug for WorkerCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkerCounts").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::{Metrics, MetricsOptions};

    #[test]
    fn metrics_exist_at_zero_from_the_start() {
        let worker = WorkerCounts::new("1.2.3", 2, 32);
        worker.add_busy_time(Duration::from_millis(1500));
        worker.reply("busy");
        let text = worker.text(&WorkerGauges { held: 3, ready: true, ..WorkerGauges::default() });
        for line in [
            "veiloc_workers 2\n",
            "veiloc_objects_loaded 3\n",
            "veiloc_ready 1\n",
            "veiloc_busy_seconds_total 1.5\n",
            "veiloc_worker_replies_total{outcome=\"busy\"} 1\n",
            "veiloc_worker_requests_total{kind=\"pose\"} 0\n",
            "veiloc_worker_cancellations_total{state=\"queued\"} 0\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
        let gateway = GatewayCounts::default();
        let metrics = Metrics::new(&MetricsOptions { gateway: Some(&gateway), ..MetricsOptions::default() });
        gateway.message("no-subscriber");
        gateway.hedged();
        let text = metrics.text(&crate::telemetry::GaugeValues::default());
        for line in [
            "veiloc_cluster_messages_total{outcome=\"no-subscriber\"} 1\n",
            "veiloc_cluster_messages_total{outcome=\"answered\"} 0\n",
            "veiloc_cluster_hedges_total 1\n",
            "veiloc_cluster_gateways{state=\"silent\"} 0\n",
            "veiloc_cluster_peer_requests_total 0\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
