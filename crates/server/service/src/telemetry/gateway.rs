//! Metrics of regions: of gateways, which send queries to workers, and of workers, which open regions.

use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

type Labels = Vec<(&'static str, &'static str)>;

/// Buckets from 1 ms to 30 s.
const SECONDS: [f64; 12] = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0, 30.0];

/// Ends of a request to a worker.
const OUTCOMES: [&str; 6] = ["answered", "busy", "failed", "refused", "invalid", "superseded"];

/// Metrics of a gateway; clones share the values.
#[derive(Debug, Clone)]
pub struct GatewayCounts {
    requests: Family<Labels, Counter>,
    hedges: Counter,
    round_trips: Histogram,
    regions: Histogram,
    manifests: Counter,
    workers: Family<Labels, Gauge>,
}

impl Default for GatewayCounts {
    fn default() -> Self {
        let counts = Self {
            requests: Family::default(),
            hedges: Counter::default(),
            round_trips: Histogram::new(SECONDS),
            regions: Histogram::new([1.0, 2.0, 3.0, 4.0, 6.0, 8.0]),
            manifests: Counter::default(),
            workers: Family::default(),
        };
        counts.workers(0, 0);
        for outcome in OUTCOMES {
            drop(counts.requests.get_or_create(&vec![("outcome", outcome)]));
        }
        counts
    }
}

impl GatewayCounts {
    /// Counts a request to a worker by its outcome.
    pub fn request(&self, outcome: &'static str) {
        self.requests.get_or_create(&vec![("outcome", outcome)]).inc();
    }

    /// Counts a hedged request: the same bytes were sent again before the first answer.
    pub fn hedged(&self) {
        self.hedges.inc();
    }

    /// Records the time of a request that a worker answered.
    pub fn round_trip(&self, took: Duration) {
        self.round_trips.observe(took.as_secs_f64());
    }

    /// Records the number of regions in which a query was searched.
    pub fn regions_searched(&self, count: usize) {
        self.regions.observe(count as f64);
    }

    /// Counts a manifest that came into use.
    pub fn manifest_activated(&self) {
        self.manifests.inc();
    }

    /// Sets the numbers of workers that answer, and that are put aside.
    pub fn workers(&self, answering: usize, aside: usize) {
        for (state, count) in [("answering", answering), ("aside", aside)] {
            self.workers.get_or_create(&vec![("state", state)]).set(count as i64);
        }
    }

    pub(crate) fn register(&self, registry: &mut Registry) {
        let registry = registry.sub_registry_with_prefix("gateway");
        registry.register("requests", "Requests to workers, by how they ended", self.requests.clone());
        let help = "Requests that were sent to a second worker before the first answered";
        registry.register("hedges", help, self.hedges.clone());
        let help = "Time of a request that a worker answered";
        registry.register("round_trip_seconds", help, self.round_trips.clone());
        registry.register("regions", "Regions in which a query was searched", self.regions.clone());
        registry.register("manifests", "Manifests that came into use", self.manifests.clone());
        registry.register("workers", "Workers, by state", self.workers.clone());
    }
}

/// Metrics of a worker; clones share the values.
#[derive(Debug, Clone)]
pub struct RegionCounts {
    open: Gauge,
    reads: Family<Labels, Counter>,
    failing: Counter,
}

impl Default for RegionCounts {
    fn default() -> Self {
        let counts = Self { open: Gauge::default(), reads: Family::default(), failing: Counter::default() };
        for from in ["store", "cache"] {
            drop(counts.reads.get_or_create(&vec![("from", from)]));
        }
        counts
    }
}

impl RegionCounts {
    /// Sets the number of open regions.
    pub fn open(&self, count: usize) {
        self.open.set(count as i64);
    }

    /// Counts a region that was opened; from the store, or from the cache on the local disk.
    pub fn read(&self, from_store: bool) {
        self.reads.get_or_create(&vec![("from", if from_store { "store" } else { "cache" })]).inc();
    }

    /// Counts a manifest or region that could not be read.
    pub fn failed(&self) {
        self.failing.inc();
    }

    pub(crate) fn register(&self, registry: &mut Registry) {
        registry.register("regions_open", "Regions in memory", self.open.clone());
        let help = "Regions that were opened, from the store or from the cache on the local disk";
        registry.register("region_reads", help, self.reads.clone());
        let help = "Manifests and regions that could not be read";
        registry.register("region_failures", help, self.failing.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::{Metrics, MetricsOptions};

    #[test]
    fn metrics_exist_at_zero_from_the_start() {
        let (gateway, regions) = (GatewayCounts::default(), RegionCounts::default());
        let options =
            MetricsOptions { gateway: Some(&gateway), regions: Some(&regions), ..MetricsOptions::default() };
        let metrics = Metrics::new(&options);
        gateway.request("busy");
        regions.read(true);
        let text = metrics.text(&crate::telemetry::GaugeValues::default());
        for line in [
            "veiloc_gateway_requests_total{outcome=\"busy\"} 1\n",
            "veiloc_gateway_requests_total{outcome=\"answered\"} 0\n",
            "veiloc_gateway_hedges_total 0\n",
            "veiloc_gateway_workers{state=\"aside\"} 0\n",
            "veiloc_region_reads_total{from=\"store\"} 1\n",
            "veiloc_region_reads_total{from=\"cache\"} 0\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
