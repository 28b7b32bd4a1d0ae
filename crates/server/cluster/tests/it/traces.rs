//! A trace goes on in the workers: their spans have the trace of the request and the message of the gateway as parent.

use super::common;

use std::sync::Arc;

use common::service::collector::{Collector, attribute};
use common::service::{Running, no_timeouts, truth};
use common::{MAP, PublishedMap, TestCluster, eventually, worker_options};
use serde_json::Value;
use tokio::task::block_in_place;
use veiloc_cluster::bus::Bus;
use veiloc_service::telemetry::Traces;
use veiloc_service::{RemoteMap, ServerOptions};

fn id<'a>(span: &'a Value, key: &str) -> &'a str {
    span[key].as_str().unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread")]
async fn trace_of_a_query_continues_in_workers() {
    let published = PublishedMap::new(10);
    let collector = Collector::start();
    let mut worker = worker_options("all");
    worker.traces = Some(Traces::start(&collector.address, "veiloc-worker", "test").expect("a thread"));
    let cluster = TestCluster::start_with(&published, Bus::in_process(), vec![worker]).await;
    cluster.knows(1).await;
    let mut options = ServerOptions::new(Vec::new());
    options.listen = vec!["127.0.0.1:0".parse().expect("an address")];
    options.timeouts = no_timeouts();
    let backend = Arc::new(cluster.gateway.clone());
    options.remote_maps = vec![RemoteMap { name: MAP.to_owned(), backend }];
    let query = published.query(&truth());
    let path = format!("/v1/maps/{MAP}/localize");
    let localize = |server: &Running| {
        let request = common::service::http::Request::post(&path, &query);
        let response = request.header("content-type", "application/x-protobuf").send(server.address);
        assert_eq!(response.status, 200, "{response:?}");
        response.header("veiloc-request-id").expect("a name").to_owned()
    };
    // A gateway without traces: its worker sends nothing.
    let silent = block_in_place(|| Running::start(options.clone()));
    let untraced = block_in_place(|| localize(&silent));
    options.otlp = Some(collector.address.clone());
    let server = block_in_place(|| Running::start(options));
    let request = block_in_place(|| localize(&server));
    // A search, and a pose in the only region; each with its queue and work, the pose with its three parts too.
    eventually("the spans of the worker", || collector.spans("veiloc-worker").len() == 9).await;
    block_in_place(|| server.stop());

    let (gateway, worker) = (collector.spans("veiloc"), collector.spans("veiloc-worker"));
    assert!(gateway.iter().chain(&worker).all(|span| id(span, "traceId") == request), "{untraced}");
    let calls: Vec<&Value> = gateway.iter().filter(|span| span["name"] == "ask worker").collect();
    assert_eq!(calls.len(), 2);
    let localize = gateway.iter().find(|span| span["name"] == "localize").expect("a stage");
    let member = cluster.handle().member().to_string();
    for (call, (name, object)) in
        calls.iter().zip([("search", published.index()), ("pose", published.region(0))])
    {
        assert_eq!((&call["kind"], id(call, "parentSpanId")), (&3.into(), id(localize, "spanId")));
        assert_eq!(attribute(call, "veiloc.worker"), Some(&*member));
        assert_eq!(attribute(call, "veiloc.outcome"), Some("answered"));
        let of_call: Vec<&Value> =
            worker.iter().filter(|span| span["parentSpanId"] == call["spanId"]).collect();
        let [work] = of_call[..] else { panic!("one span within {call}: {of_call:?}") };
        assert_eq!((id(work, "name"), &work["kind"]), (name, &2.into()));
        assert_eq!(attribute(work, "veiloc.object"), Some(&*object.to_string()));
        assert_eq!(attribute(work, "veiloc.worker"), Some(&*member));
        let stages = worker.iter().filter(|span| span["parentSpanId"] == work["spanId"]);
        assert_eq!(stages.map(|span| id(span, "name")).collect::<Vec<_>>(), ["queue", "localize"]);
    }
    let mut ids: Vec<&str> = gateway.iter().chain(&worker).map(|span| id(span, "spanId")).collect();
    ids.sort_unstable();
    let count = ids.len();
    ids.dedup();
    assert_eq!(ids.len(), count, "span ids differ");
}
