//! The rate of a token holds over all gateways: services with tokens that exchange what they accept.

use super::bus::servers::Servers;
use super::common;

use std::time::Duration;

use common::eventually;
use common::service::{Files, ManualClock, PHONE, Running};
use tokio::task::{JoinHandle, block_in_place};
use veiloc_cluster::bus::Bus;
use veiloc_cluster::{RateExchangeOptions, share_rates};
use veiloc_service::SharedRates;
use veiloc_service::telemetry::GatewayCounts;

/// A gateway as far as rates are concerned: a service, and its exchange with others.
struct RatedGateway {
    server: Running,
    exchange: JoinHandle<()>,
}

impl RatedGateway {
    async fn start(bus: &Bus, files: &Files, clock: &ManualClock, options: RateExchangeOptions) -> Self {
        let (rates, counts) = (SharedRates::default(), GatewayCounts::default());
        let exchange = share_rates(bus, rates.clone(), options, counts.clone()).await.expect("exchanged");
        let mut server = files.options();
        server.rate.per_second = 5.try_into().expect("not zero");
        server.rate.burst = 5.try_into().expect("not zero");
        server.clock = clock.clock();
        (server.shared_rates, server.gateway) = (Some(rates), Some(counts));
        Self { server: block_in_place(|| Running::start(server)), exchange }
    }

    /// Sends this many requests; returns how many were accepted.
    fn accepted(&self, requests: usize) -> usize {
        let accepted = || block_in_place(|| self.server.get("/v1/maps", PHONE).status == 200);
        (0..requests).filter(|_| accepted()).count()
    }

    /// Waits until a metric has this value.
    async fn reports(&self, series: &str, value: f64) {
        eventually(series, || block_in_place(|| self.server.metric(series) == Some(value))).await;
    }
}

const PEER_REQUESTS: &str = "veiloc_cluster_peer_requests_total";
const REPORTING: &str = "veiloc_cluster_gateways{state=\"reporting\"}";
const SILENT: &str = "veiloc_cluster_gateways{state=\"silent\"}";

#[tokio::test(flavor = "multi_thread")]
async fn two_gateways_share_the_rate_of_a_token() {
    let bus = Bus::in_process();
    check_shared_rate([&bus, &bus]).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn two_gateways_share_the_rate_of_a_token_over_nats() {
    let servers = Servers::start(2, 1 << 20);
    let connect = || async { Bus::nats(&servers.options()).await.expect("connected") };
    check_shared_rate([&connect().await, &connect().await]).await;
}

async fn check_shared_rate(buses: [&Bus; 2]) {
    let (files, clock) = (Files::new(), ManualClock::new());
    let [first, second] =
        buses.map(|bus| RatedGateway::start(bus, &files, &clock, RateExchangeOptions::default()));
    let (first, second) = (first.await, second.await);
    // Within the burst of five, three here and two there.
    assert_eq!(first.accepted(3), 3);
    second.reports(PEER_REQUESTS, 3.0).await;
    assert_eq!(second.accepted(4), 2);
    first.reports(PEER_REQUESTS, 2.0).await;
    assert_eq!(first.accepted(1), 0);
    // Five in a second, wherever they are sent.
    for (here, there, from_here) in [(&first, &second, 8.0), (&second, &first, 7.0)] {
        clock.advance(Duration::from_secs(1));
        assert_eq!(here.accepted(9), 5);
        there.reports(PEER_REQUESTS, from_here).await;
        assert_eq!(there.accepted(9), 0);
    }
    // Another token is not affected.
    assert_eq!(block_in_place(|| first.server.get("/v1/maps", common::service::OPERATOR).status), 200);
    // A gateway that stops says so.
    first.reports(REPORTING, 1.0).await;
    block_in_place(|| second.server.stop());
    first.reports(REPORTING, 0.0).await;
    first.reports(SILENT, 0.0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_gateway_is_counted_if_asked() {
    for (count_silent, accepted) in [(false, 5), (true, 2)] {
        let (bus, files, clock) = (Bus::in_process(), Files::new(), ManualClock::new());
        let mut options = RateExchangeOptions::default();
        options.count_silent = count_silent;
        let first = RatedGateway::start(&bus, &files, &clock, options.clone()).await;
        options.period = Duration::from_millis(10);
        let second = RatedGateway::start(&bus, &files, &clock, options).await;
        first.reports(REPORTING, 1.0).await;
        // As if it were killed.
        second.exchange.abort();
        first.reports(SILENT, 1.0).await;
        assert_eq!(first.accepted(9), accepted, "count_silent {count_silent}");
    }
}
