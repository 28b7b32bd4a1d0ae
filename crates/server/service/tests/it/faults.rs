//! Faults of connections are counted by kind, and normal ends are not; every response has its duration in the
//! histogram, whatever its status.

use super::common;

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};

use common::http::{Request, Response, connect, has_data};
use common::{Files, ManualClock, OPERATOR, PHONE, Running, SECOND, data, eventually, truth, value};
use veiloc_service::TlsFiles;

fn faults(server: &Running, kind: &str) -> f64 {
    let series = format!("veiloc_connection_faults_total{{kind=\"{kind}\"}}");
    server.metric(&series).unwrap_or_else(|| panic!("{series} is not there from the start"))
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

/// All input until the end, while the paused clock advances.
fn rest_in_time(server: &Running, stream: &mut TcpStream) -> String {
    let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
    stream.set_nonblocking(true).expect("set");
    server.pass_until(SECOND, "the end of a connection", || {
        loop {
            match stream.read(&mut piece) {
                Ok(count @ 1..) => bytes.extend_from_slice(&piece[..count]),
                Err(e) if e.kind() == ErrorKind::WouldBlock => return false,
                _ => return true,
            }
        }
    });
    String::from_utf8_lossy(&bytes).into_owned()
}

/// All input until the end.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    // A reset connection has delivered its input before.
    let _ = stream.read_to_end(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn faults_of_plain_connections_are_counted_by_kind() {
    let files = Files::new();
    let mut options = files.options();
    options.timeouts.head = 5 * SECOND;
    let server = Running::start_paused(options);
    for kind in KINDS {
        assert_eq!(faults(&server, kind), 0.0, "{kind}");
    }

    // Not a fault: disconnecting after a response, exceeding the idle time, disconnecting without input.
    assert_eq!(server.get("/healthz", "").status, 200);
    let mut idle = connect(server.address);
    idle.write_all(&Request::get("/healthz").bytes()).expect("sent");
    assert_eq!(Response::read(&mut idle).status, 200);
    assert_eq!(rest_in_time(&server, &mut idle), "", "closed while idle");
    assert_eq!(rest_in_time(&server, &mut connect(server.address)), "", "closed without input");
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
    server.pass_until(SECOND, "a head that does not end", || faults(&server, "head-timeout") == 1.0);
    assert_eq!(rest(&mut slow), "");

    let mut half = connect(server.address);
    half.write_all(b"GET /healthz HTTP/1.1\r\nho").expect("sent");
    half.shutdown(Shutdown::Both).expect("closed");
    eventually("a head that broke off", || faults(&server, "interrupted") == 1.0);

    for kind in ["tls-handshake", "tls-timeout", "answer-timeout", "left"] {
        assert_eq!(faults(&server, kind), 0.0, "{kind}");
    }
}

#[test]
fn client_that_disconnects_early_is_counted() {
    let files = Files::new();
    let mut options = files.options();
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    let server = Running::start(options);
    let mut leaving = connect(server.address);
    let query = files.scene.sealed(&truth());
    leaving.write_all(&Request::localize(&query).token(PHONE).bytes()).expect("sent");
    eventually("work on it", || server.metric("veiloc_workers_busy") == Some(1.0));
    leaving.shutdown(Shutdown::Both).expect("closed");
    eventually("a client that left", || faults(&server, "left") == 1.0);
}

#[test]
fn failed_and_slow_handshakes_are_counted() {
    let files = Files::new();
    let mut options = files.options();
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data("key.pem"), client_ca: None });
    options.timeouts.head = 5 * SECOND;
    let server = Running::start_paused(options);
    let mut plain = connect(server.address);
    plain.write_all(&Request::get("/healthz").bytes()).expect("sent");
    rest(&mut plain);
    eventually("a handshake that is none", || faults(&server, "tls-handshake") == 1.0);
    let mut silent = connect(server.address);
    server.pass_until(SECOND, "a handshake that lasts", || faults(&server, "tls-timeout") == 1.0);
    assert_eq!(rest(&mut silent), "");
}

#[test]
fn durations_by_status_and_requests_by_token_are_counted() {
    let files = Files::new();
    let mut options = files.options();
    options.rate.burst = 4.try_into().expect("not zero");
    options.rate.per_second = std::num::NonZeroU32::MIN;
    options.clock = ManualClock::new().clock();
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&files.scene.sealed_without_features(), PHONE).status, 422);
    assert_eq!(server.localize(b"no query", PHONE).status, 400);
    assert_eq!(server.localize(&query, "unknown").status, 401);
    assert_eq!(server.get("/v1/maps/place/localize", "").status, 405);
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&query, PHONE).status, 429);
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
    assert!(!text.contains("token=\"someone\",status=\"401\""), "no request had this token:\n{text}");
    // Stopped during its search.
    let mut options = files.options();
    options.timeouts.localize = 10 * SECOND;
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    let server = Running::start_paused(options);
    let mut stream = connect(server.address);
    stream.write_all(&Request::localize(&query).token(PHONE).bytes()).expect("sent");
    server.pass_until(SECOND, "an answer", || has_data(&stream));
    assert_eq!(Response::read(&mut stream).status, 504);
    let text = server.get("/metrics", OPERATOR).text();
    assert!(
        text.contains("veiloc_request_seconds_count{route=\"/v1/maps/{name}/localize\",status=\"504\"} 1"),
        "{text}"
    );
}
