//! What an operator may watch of a cluster: what a gateway asks, and what a worker does.

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

/// From a tenth of a millisecond to ten seconds.
const SECONDS: [f64; 15] =
    [0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0];

/// How a message to a worker ended, as the gateway sees it.
const ENDS: [&str; 6] = ["answered", "nobody", "turned-away", "no-reply", "bad-reply", "not-needed"];

/// What a worker is asked.
const WANTED: [&str; 3] = ["ping", "search", "pose"];

/// How a worker answered.
const SAID: [&str; 6] = ["answered", "unanswered", "busy", "twin", "unread", "broken"];

/// What a worker was at when nobody waited for its answer any more.
const WHEN: [&str; 2] = ["waiting", "working"];

/// What a gateway counts; clones count together.
#[derive(Clone)]
pub struct GatewayCounts {
    messages: Family<Labels, Counter>,
    hedges: Counter,
    road: Histogram,
    regions: Histogram,
    editions: Counter,
    whole: Gauge,
}

impl Default for GatewayCounts {
    fn default() -> Self {
        let counts = Self {
            messages: Family::default(),
            hedges: Counter::default(),
            road: Histogram::new(SECONDS),
            regions: Histogram::new([1.0, 2.0, 3.0, 4.0, 6.0, 8.0]),
            editions: Counter::default(),
            whole: Gauge::default(),
        };
        for end in ENDS {
            drop(counts.messages.get_or_create(&vec![("end", end)]));
        }
        counts
    }
}

impl GatewayCounts {
    /// A message to a worker that ended so.
    pub fn message(&self, end: &'static str) {
        self.messages.get_or_create(&vec![("end", end)]).inc();
    }

    /// The same bytes were sent again before the first were answered.
    pub fn hedged(&self) {
        self.hedges.inc();
    }

    /// What the road to a worker and back took beside its work and the wait for it.
    pub fn road(&self, took: Duration) {
        self.road.observe(took.as_secs_f64());
    }

    /// A query was asked in so many regions.
    pub fn asked_regions(&self, count: usize) {
        self.regions.observe(count as f64);
    }

    /// A manifest is asked from now on.
    pub fn edition(&self) {
        self.editions.inc();
    }

    /// Whether every region of every map was reached when its manifest was taken.
    pub fn whole(&self, whole: bool) {
        self.whole.set(whole.into());
    }

    pub(crate) fn register(&self, registry: &mut Registry) {
        let registry = registry.sub_registry_with_prefix("cluster");
        registry.register("messages", "Messages to workers, by how they ended", self.messages.clone());
        registry.register("hedges", "Messages sent again before an answer", self.hedges.clone());
        registry.register(
            "road_seconds",
            "Time to a worker and back beside its work and the wait for it",
            self.road.clone(),
        );
        registry.register("regions", "Regions that a query was asked in", self.regions.clone());
        registry.register("manifests", "Manifests that were taken", self.editions.clone());
        registry.register("whole", "1 when all regions of all maps could be reached", self.whole.clone());
    }
}

impl fmt::Debug for GatewayCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GatewayCounts").finish_non_exhaustive()
    }
}

/// What is read of a worker at the moment of a scrape.
#[derive(Debug, Clone, Copy, Default)]
pub struct WorkerNow {
    /// Requests that wait.
    pub queued: usize,
    /// Threads that localize at the moment.
    pub busy: usize,
    /// Regions and indexes that it holds.
    pub held: usize,
    /// Whether it is asked.
    pub ready: bool,
}

/// What a worker counts, with the registry that a scrape reads.
pub struct WorkerCounts {
    registry: Registry,
    asked: Family<Labels, Counter>,
    said: Family<Labels, Counter>,
    cancelled: Family<Labels, Counter>,
    busy_seconds: Counter<f64, AtomicU64>,
    failing: Gauge,
    now: [Gauge; 4],
}

impl WorkerCounts {
    /// Everything at zero, with so many threads and places in the queue.
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
        let held = gauge(registry, "objects_held", "Regions and indexes in memory", 0);
        let ready = gauge(registry, "ready", "1 while it is asked, as /readyz says", 0);
        let failing =
            gauge(registry, "reload_failing", "1 while a manifest cannot be taken and an older one is", 0);
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
        let asked = family(registry, "asked", "Requests of gateways, by what was wanted", "wanted", &WANTED);
        let said = family(registry, "said", "Replies to gateways, by what was said", "said", &SAID);
        let help = "Requests whose answer nobody waited for any more, by what was being done with them";
        let cancelled = family(registry, "cancelled", help, "when", &WHEN);
        let busy_seconds: Counter<f64, AtomicU64> = Counter::default();
        registry.register("busy_seconds", "Time that threads localized, in all", busy_seconds.clone());
        let now = [queued, busy, held, ready];
        Arc::new(Self { registry: all, asked, said, cancelled, busy_seconds, failing, now })
    }

    /// A request came.
    pub fn asked(&self, wanted: &'static str) {
        self.asked.get_or_create(&vec![("wanted", wanted)]).inc();
    }

    /// A reply went.
    pub fn said(&self, said: &'static str) {
        self.said.get_or_create(&vec![("said", said)]).inc();
    }

    /// Nobody waits for the answer to a request any more, which was `waiting` or which a thread was `working` on.
    pub fn cancelled(&self, when: &'static str) {
        self.cancelled.get_or_create(&vec![("when", when)]).inc();
    }

    /// A thread worked for so long.
    pub fn worked(&self, took: Duration) {
        self.busy_seconds.inc_by(took.as_secs_f64());
    }

    /// Whether the newest manifest cannot be taken.
    pub fn failing(&self, failing: bool) {
        self.failing.set(failing.into());
    }

    /// All of it in the text format of Prometheus.
    pub fn text(&self, now: &WorkerNow) -> String {
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
    fn what_may_be_asked_for_is_there_before_it_happened() {
        let worker = WorkerCounts::new("1.2.3", 2, 32);
        worker.worked(Duration::from_millis(1500));
        worker.said("busy");
        let text = worker.text(&WorkerNow { held: 3, ready: true, ..WorkerNow::default() });
        for line in [
            "veiloc_workers 2\n",
            "veiloc_objects_held 3\n",
            "veiloc_ready 1\n",
            "veiloc_busy_seconds_total 1.5\n",
            "veiloc_said_total{said=\"busy\"} 1\n",
            "veiloc_asked_total{wanted=\"pose\"} 0\n",
            "veiloc_cancelled_total{when=\"waiting\"} 0\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
        let gateway = GatewayCounts::default();
        let metrics = Metrics::new(&MetricsOptions { gateway: Some(&gateway), ..MetricsOptions::default() });
        gateway.message("nobody");
        gateway.hedged();
        let text = metrics.text(&crate::telemetry::Now::default());
        for line in [
            "veiloc_cluster_messages_total{end=\"nobody\"} 1\n",
            "veiloc_cluster_messages_total{end=\"answered\"} 0\n",
            "veiloc_cluster_hedges_total 1\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
