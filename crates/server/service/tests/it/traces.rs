//! Traces: one span per request and per stage, with the request id as trace id and no content of a query.

use super::common;

use std::collections::BTreeSet;

use common::collector::{Collector, attribute};
use common::http::Request;
use common::mark::{MARK, find_mark, marked};
use common::{Files, OPERATOR, PHONE, Running, eventually, truth};
use serde_json::Value;

/// Keys of all objects.
fn keys(value: &Value, into: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                into.insert(key.clone());
                keys(value, into);
            }
        }
        Value::Array(values) => {
            for value in values {
                keys(value, into);
            }
        }
        _ => {}
    }
}

/// A trace id sent by a client.
const CLIENTS: &str = "0af7651916cd43dd8448eb211c80319c";

#[test]
fn spans_contain_nothing_of_a_query() {
    let files = Files::new();
    let collector = Collector::start();
    let mut options = files.options();
    options.otlp = Some(collector.address.clone());
    let server = Running::start(options);
    let mark = std::str::from_utf8(MARK).expect("ASCII");
    let parent = format!("00-{CLIENTS}-b7ad6b7169203331-01");
    let localize = |body: &[u8]| Request::localize(body).token(PHONE).header("traceparent", &parent);
    let query = marked(&files);
    let mut ids = Vec::new();
    for (request, status) in [
        (localize(&files.scene.sealed(&truth())), 200),
        (localize(&query).header("tracestate", mark).header("x-mark", mark), 422),
        (localize(&query[..query.len() - 7]), 400),
        (Request::localize(&query).token(mark), 401),
        (Request::post(&format!("/v1/maps/{mark}/localize?{mark}"), &query).token(PHONE), 404),
    ] {
        let response = request.send(server.address);
        assert_eq!(response.status, status, "{response:?}");
        ids.push(response.header("veiloc-request-id").expect("a name").to_owned());
    }
    // Probes are not traced.
    assert_eq!(server.get("/healthz", "").status, 200);
    // The shutdown does not wait long for a collector.
    eventually("all spans", || collector.spans("veiloc").len() >= 17);
    server.stop();

    let spans = collector.spans("veiloc");
    let of = |id: &str| spans.iter().filter(|span| span["traceId"] == id).collect::<Vec<_>>();
    for (id, names) in ids.iter().zip([
        &["POST /v1/maps/{name}/localize", "read", "queue", "localize", "retrieve", "match", "pose", "hold"]
            [..],
        &["POST /v1/maps/{name}/localize", "read", "queue", "localize", "hold"],
        &["POST /v1/maps/{name}/localize", "read"],
        &["POST /v1/maps/{name}/localize"],
        &["POST /v1/maps/{name}/localize"],
    ]) {
        let spans = of(id);
        let found: Vec<_> = spans.iter().map(|span| span["name"].as_str().expect("a name")).collect();
        assert_eq!(found, names);
        let root = spans[0]["spanId"].as_str().expect("an id");
        for span in &spans[1..] {
            let above =
                spans.iter().find(|other| other["spanId"] == span["parentSpanId"]).expect("within the trace");
            let within = matches!(span["name"].as_str(), Some("retrieve" | "match" | "pose"));
            assert_eq!(above["name"] == "localize", within, "{span}");
            assert_eq!(above["spanId"] == root, !within, "{span}");
            let time =
                |span: &Value, at: &str| span[at].as_str().expect("text").parse::<u128>().expect("a number");
            assert!(time(span, "startTimeUnixNano") >= time(above, "startTimeUnixNano"), "{span} {above}");
        }
    }
    assert_eq!(spans.len(), 8 + 5 + 2 + 1 + 1, "and nothing else");
    let first = of(&ids[0])[0];
    assert_eq!(attribute(first, "http.response.status_code"), Some("200"));
    assert_eq!(attribute(first, "veiloc.token"), Some("someone"));
    assert_eq!(attribute(first, "veiloc.map"), Some("place"));
    assert_eq!(attribute(of(&ids[1])[0], "error.type"), Some("not-localized"));

    // No client text, and no keys except these.
    let text = collector.text();
    assert!(text.starts_with("POST /v1/traces HTTP/1.1\r\n") && text.contains("application/json"), "{text}");
    assert_eq!(find_mark(&text), None, "{text}");
    for secret in [CLIENTS, "b7ad6b7169203331", PHONE, OPERATOR] {
        assert!(!text.contains(secret), "{secret} leaked:\n{text}");
    }
    let mut found = BTreeSet::new();
    for span in &spans {
        keys(span, &mut found);
    }
    let allowed = [
        "attributes",
        "endTimeUnixNano",
        "intValue",
        "key",
        "kind",
        "name",
        "parentSpanId",
        "spanId",
        "startTimeUnixNano",
        "stringValue",
        "traceId",
        "value",
    ];
    assert_eq!(found, allowed.map(str::to_owned).into());
    let attributes: BTreeSet<_> = spans
        .iter()
        .flat_map(|span| span["attributes"].as_array().cloned().unwrap_or_default())
        .map(|attribute| attribute["key"].as_str().expect("a key").to_owned())
        .collect();
    let allowed = [
        "error.type",
        "http.request.method",
        "http.response.status_code",
        "http.route",
        "veiloc.map",
        "veiloc.token",
    ];
    assert_eq!(attributes, allowed.map(str::to_owned).into());
}

/// An absent collector delays no request, and dropped spans are counted.
#[test]
fn absent_collector_does_not_delay_requests() {
    let files = Files::new();
    let mut options = files.options();
    // Bound but not listening: no other process gets the port, and connections are refused.
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).expect("a socket");
    let any: std::net::SocketAddr = "127.0.0.1:0".parse().expect("an address");
    socket.bind(&any.into()).expect("a port");
    let address = socket.local_addr().expect("bound").as_socket().expect("of TCP");
    options.otlp = Some(format!("http://{address}"));
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    for _ in 0..5 {
        assert_eq!(server.localize(&query, PHONE).status, 200);
    }
    let admin = server.listening.admin.expect("a listener for the operator");
    eventually("all spans given up", || {
        Request::get("/metrics").send(admin).text().contains("veiloc_spans_dropped_total 40\n")
    });
    server.stop();
}

#[tokio::test]
async fn invalid_collector_address_is_refused() {
    let files = Files::new();
    for address in ["", "collector:4318", "grpc://collector", "http://"] {
        let mut options = files.options();
        options.otlp = Some(address.to_owned());
        let error = veiloc_service::Server::bind(options).await.err().expect("refused").to_string();
        assert!(error.contains("http://127.0.0.1:4318"), "{address}: {error}");
    }
}

/// A worker continues the trace of its gateway: same id in the answer, and the span of the gateway as parent.
#[test]
fn trace_of_a_gateway_is_continued() {
    const GATEWAY: &str = "gateway-token";
    let files = Files::new();
    let tokens = common::tokens_file(&[(GATEWAY, "gateway"), (PHONE, "")]);
    std::fs::write(files.path("tokens"), tokens).expect("written");
    let collector = Collector::start();
    let mut options = files.options();
    options.otlp = Some(collector.address.clone());
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let ask = |token: &str, parent: &str| {
        let request = Request::localize(&query).token(token).header("traceparent", parent);
        let response = request.send(server.address);
        assert_eq!(response.status, 200, "{response:?}");
        response.header("veiloc-request-id").expect("an id").to_owned()
    };
    let parent = format!("00-{CLIENTS}-b7ad6b7169203331-01");
    assert_eq!(ask(GATEWAY, &parent), CLIENTS);
    assert_ne!(ask(PHONE, &parent), CLIENTS);
    let zeros = "0".repeat(32);
    for bad in [
        "",
        "00",
        &format!("01-{CLIENTS}-b7ad6b7169203331-01"),
        &format!("00-{zeros}-b7ad6b7169203331-01"),
        &format!("00-{CLIENTS}-0000000000000000-01"),
        &format!("00-{CLIENTS}-b7ad-01"),
    ] {
        let id = ask(GATEWAY, bad);
        assert!(id != CLIENTS && id != zeros, "{bad}");
    }
    eventually("the spans", || collector.spans("veiloc").iter().any(|span| span["traceId"] == CLIENTS));
    server.stop();
    let spans = collector.spans("veiloc");
    let continued: Vec<&Value> = spans.iter().filter(|span| span["traceId"] == CLIENTS).collect();
    assert_eq!(continued[0]["parentSpanId"], "b7ad6b7169203331");
    assert!(continued[1..].iter().all(|span| span["parentSpanId"] != "b7ad6b7169203331"));
    let ids: BTreeSet<String> = continued.iter().map(|span| span["spanId"].to_string()).collect();
    assert_eq!(ids.len(), continued.len(), "span ids differ");
}
