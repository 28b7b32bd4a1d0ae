//! Unauthenticated clients and a stuck log cannot block the service.

use super::common;

use std::io::{self, Write};
use std::net::TcpStream;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::http::{Request, Response, connect};
use common::{Files, OPERATOR, PHONE, Running, SECOND, eventually, truth};
use veiloc_service::{LogQueue, Server, ServerError};

fn number(n: usize) -> NonZeroUsize {
    NonZeroUsize::new(n).expect("not zero")
}

/// Sends a request on a persistent connection.
fn ask(stream: &mut TcpStream, request: &Request) -> Option<Response> {
    let _ = stream.write_all(&request.bytes());
    Response::try_read(stream)
}

#[test]
fn idle_unauthenticated_connections_do_not_block_tokens() {
    let files = Files::new();
    let mut options = files.options();
    options.connections = number(8);
    let server = Running::start(options);
    let (probe, query) = (Request::get("/healthz"), files.scene.sealed(&truth()));
    let mut with_token = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    assert_eq!(ask(&mut with_token, &list).expect("an answer").status, 200);
    let mut unknown: Vec<TcpStream> = Vec::new();
    for _ in 0..40 {
        let mut stream = connect(server.address);
        assert_eq!(ask(&mut stream, &probe).expect("an answer").status, 200);
        unknown.push(stream);
    }
    // A new client with a token is answered, and so is the earlier one.
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(ask(&mut with_token, &list).expect("still there").status, 200);
    let open = unknown.iter_mut().filter_map(|stream| ask(stream, &probe)).count();
    assert!((1..=4).contains(&open), "half of eight are reserved, and {open} unknown clients are there");
    let text = server.get("/metrics", OPERATOR).text();
    assert!(text.contains("veiloc_connections_closed_total{reason=\"evicted\"}"), "{text}");
    // The operator's listener needs no token and is not affected.
    let admin = server.listening.admin.expect("a listener");
    assert_eq!(Request::get("/readyz").send(admin).text(), "ready\n");
    assert!(Request::get("/metrics").send(admin).text().contains("veiloc_connections "));
    assert_eq!(Request::localize(&query).token(PHONE).send(admin).status, 404, "it does not localize");
    assert_eq!(Request::get("/v1/maps").token(PHONE).send(admin).status, 404);
}

#[test]
fn unauthenticated_connections_have_a_short_lifetime() {
    let files = Files::new();
    let mut options = files.options();
    options.timeouts.unauthenticated_max_age = 5 * SECOND;
    let server = Running::start_paused(options);
    let (mut client, mut known) = (connect(server.address), connect(server.address));
    let (list, probe) = (Request::get("/v1/maps").token(PHONE), Request::get("/healthz"));
    assert_eq!(ask(&mut known, &list).expect("an answer").status, 200);
    assert_eq!(ask(&mut client, &probe).expect("an answer").status, 200);
    server.pass_until(SECOND, "the end of the unknown client's connection", || {
        assert_eq!(ask(&mut known, &list).expect("still there").status, 200);
        ask(&mut client, &probe).is_none()
    });
    assert_eq!(ask(&mut known, &list).expect("still there").status, 200);
}

#[test]
fn connections_have_a_maximum_lifetime() {
    let files = Files::new();
    let mut options = files.options();
    options.timeouts.max_age = 5 * SECOND;
    let server = Running::start_paused(options);
    let mut known = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    assert_eq!(ask(&mut known, &list).expect("an answer").status, 200);
    server.pass_until(SECOND, "the end of the connection", || ask(&mut known, &list).is_none());
}

#[test]
fn stuck_log_delays_no_request_and_refusals_are_limited() {
    common::own_process::run_in_own_process(
        "unknown_clients::stuck_log_delays_no_request_and_refusals_are_limited",
        stick_the_log,
    );
}

fn stick_the_log() {
    #[derive(Clone)]
    struct Stuck(Arc<Mutex<Vec<u8>>>);
    impl Write for Stuck {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("not poisoned").extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    let written = Stuck(Arc::default());
    let log = LogQueue::start(written.clone()).expect("a thread");
    let queue = log.clone();
    tracing_subscriber::fmt().with_writer(move || queue.line()).with_ansi(false).init();
    let files = Files::new();
    let mut options = files.options();
    options.log = Some(log.clone());
    // With a paused clock all requests are within one minute.
    let server = Running::start_paused(options);
    for _ in 0..100 {
        assert_eq!(server.get("/v1/maps", "guess").status, 401);
    }
    assert!(log.flush(Duration::from_secs(60)));
    let text = String::from_utf8(written.0.lock().expect("not poisoned").clone()).expect("text");
    let refusals = text.lines().filter(|line| line.contains("unauthenticated")).count();
    assert_eq!(refusals, 10, "of 100 refusals in a minute");

    // Block the sink.
    let stuck = written.0.lock().expect("not poisoned");
    let none_dropped =
        || server.get("/metrics", OPERATOR).text().contains("veiloc_log_lines_dropped_total 0");
    assert!(none_dropped(), "nothing was dropped yet");
    let mut stream = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    for _ in 0..5000 {
        assert_eq!(ask(&mut stream, &list).expect("an answer").status, 200);
    }
    assert!(!none_dropped(), "lines were dropped and counted");
    assert_eq!(server.stop().given_up, 0, "shutdown is not blocked");
    drop(stuck);
    eventually("a report of dropped lines", || {
        let text = written.0.lock().expect("not poisoned").clone();
        String::from_utf8_lossy(&text).contains("log lines were dropped")
    });
}

#[test]
fn reserving_all_connections_is_refused() {
    let files = Files::new();
    let mut options = files.options();
    options.connections = number(8);
    options.reserved_connections = Some(8);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    let refused = runtime.block_on(Server::bind(options)).err();
    assert!(matches!(refused, Some(ServerError::Reserved { .. })), "{refused:?}");
}
