//! What goes wrong below the requests is counted by kind, and what is no fault is not; every answer has its time in the
//! histogram, whatever its status.

use super::common;

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use common::http::{Request, connect};
use common::{Files, OPERATOR, PHONE, Running, data, eventually, truth};
use veiloc_service::TlsFiles;

/// What the metrics say of a series; `None` when it is not there.
fn value(text: &str, series: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' '))?;
    Some(line.parse().expect("a number"))
}

fn metrics(server: &Running) -> String {
    let admin = server.listening.admin.expect("a listener for the operator");
    Request::get("/metrics").send(admin).text()
}

fn faults(server: &Running, kind: &str) -> f64 {
    let series = format!("veiloc_connection_faults_total{{kind=\"{kind}\"}}");
    value(&metrics(server), &series).unwrap_or_else(|| panic!("{series} is not there from the start"))
}

const KINDS: [&str; 8] = [
    "tls-handshake",
    "tls-timeout",
    "not-http",
    "head-too-long",
    "head-timeout",
    "interrupted",
    "answer-timeout",
    "left",
];

/// All that came until the end.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    // A connection that was reset has said what it had to say.
    let _ = stream.read_to_end(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn faults_of_plain_connections_are_counted_by_kind() {
    let files = Files::new();
    let mut options = files.options();
    options.admin = Some("127.0.0.1:0".parse().expect("an address"));
    // Long for who asks at once, on a busy machine too.
    options.timeouts.head = Duration::from_millis(1500);
    let server = Running::start(options);
    for kind in KINDS {
        assert_eq!(faults(&server, kind), 0.0, "{kind}");
    }

    // No fault: asked and left, idle for too long, gone without a word.
    assert_eq!(server.get("/healthz", "").status, 200);
    let mut idle = connect(server.address);
    idle.write_all(&Request::get("/healthz").bytes()).expect("sent");
    assert!(rest(&mut idle).starts_with("HTTP/1.1 200"), "answered, then closed when it was idle");
    assert_eq!(rest(&mut connect(server.address)), "", "closed when it said nothing");
    drop(connect(server.address));

    let mut noise = connect(server.address);
    noise.write_all(b"\x16\x03\x01 this is no HTTP\r\n\r\n").expect("sent");
    assert!(rest(&mut noise).starts_with("HTTP/1.1 400"));
    eventually("a connection that spoke no HTTP", || faults(&server, "not-http") == 1.0);

    let mut long = connect(server.address);
    let _ = long.write_all(&Request::get("/healthz").header("x", &"a".repeat(100_000)).bytes());
    assert!(rest(&mut long).starts_with("HTTP/1.1 431"));
    eventually("a head that is too long", || faults(&server, "head-too-long") == 1.0);

    let mut slow = connect(server.address);
    slow.write_all(b"GET /healthz HTTP/1.1\r\nhost: te").expect("sent");
    rest(&mut slow);
    eventually("a head that does not end", || faults(&server, "head-timeout") == 1.0);

    let mut half = connect(server.address);
    half.write_all(b"GET /healthz HTTP/1.1\r\nho").expect("sent");
    half.shutdown(Shutdown::Both).expect("closed");
    eventually("a head that broke off", || faults(&server, "interrupted") == 1.0);

    for kind in ["tls-handshake", "tls-timeout", "answer-timeout", "left"] {
        assert_eq!(faults(&server, kind), 0.0, "{kind}");
    }
}

#[test]
fn a_client_that_leaves_before_its_answer_is_counted() {
    let files = Files::new();
    let mut options = files.options();
    options.admin = Some("127.0.0.1:0".parse().expect("an address"));
    options.localize.pose.fixed_hypotheses = Some(3_000_000);
    let server = Running::start(options);
    let mut leaving = connect(server.address);
    let query = files.place.sealed(&truth());
    leaving.write_all(&Request::localize(&query).token(PHONE).bytes()).expect("sent");
    eventually("work on it", || value(&metrics(&server), "veiloc_workers_busy") == Some(1.0));
    leaving.shutdown(Shutdown::Both).expect("closed");
    eventually("a client that left", || faults(&server, "left") == 1.0);
}

#[test]
fn handshakes_that_fail_or_last_are_counted() {
    let files = Files::new();
    let mut options = files.options();
    options.admin = Some("127.0.0.1:0".parse().expect("an address"));
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data("key.pem"), client_ca: None });
    // Long for who asks at once, on a busy machine too.
    options.timeouts.head = Duration::from_millis(1500);
    let server = Running::start(options);
    let mut plain = connect(server.address);
    plain.write_all(&Request::get("/healthz").bytes()).expect("sent");
    rest(&mut plain);
    eventually("a handshake that is none", || faults(&server, "tls-handshake") == 1.0);
    let mut silent = connect(server.address);
    rest(&mut silent);
    eventually("a handshake that lasts", || faults(&server, "tls-timeout") == 1.0);
}

#[test]
fn every_status_has_its_time_and_every_token_its_count() {
    let files = Files::new();
    let mut options = files.options();
    options.rate.burst = 4.try_into().expect("not zero");
    options.rate.per_second = std::num::NonZeroU32::MIN;
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&files.place.sealed_without_features(), PHONE).status, 422);
    assert_eq!(server.localize(b"no query", PHONE).status, 400);
    assert_eq!(server.localize(&query, "unknown").status, 401);
    assert_eq!(server.get("/v1/maps/place/localize", "").status, 405);
    assert_eq!(server.localize(&query, PHONE).status, 200);
    let statuses = (0..20).map(|_| server.localize(&query, PHONE).status);
    assert!(statuses.into_iter().any(|status| status == 429));
    let text = server.get("/metrics", OPERATOR).text();
    for (status, count) in [(200, 2.0), (422, 1.0), (400, 1.0), (401, 1.0), (405, 1.0)] {
        let labels = format!("route=\"/v1/maps/{{name}}/localize\",status=\"{status}\"");
        let counted = value(&text, &format!("veiloc_request_seconds_count{{{labels}}}"));
        assert!(counted >= Some(count), "{status}: {counted:?}\n{text}");
    }
    for status in [200, 422, 400, 429] {
        let series = format!("veiloc_token_requests_total{{token=\"someone\",status=\"{status}\"}}");
        assert!(value(&text, &series) >= Some(1.0), "{series}\n{text}");
    }
    assert!(!text.contains("token=\"someone\",status=\"401\""), "nobody brought this token:\n{text}");
    // Stopped in the middle of its search.
    let mut options = files.options();
    options.timeouts.localize = Duration::from_millis(1);
    options.localize.pose.fixed_hypotheses = Some(3000);
    let server = Running::start(options);
    assert_eq!(server.localize(&query, PHONE).status, 504);
    let text = server.get("/metrics", OPERATOR).text();
    assert!(
        text.contains("veiloc_request_seconds_count{route=\"/v1/maps/{name}/localize\",status=\"504\"} 1"),
        "{text}"
    );
}
