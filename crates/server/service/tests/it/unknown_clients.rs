//! What clients without a token, and a log that nobody reads, cannot do to the service.

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

/// A request on a connection that stays open.
fn ask(stream: &mut TcpStream, request: &Request) -> Option<Response> {
    let _ = stream.write_all(&request.bytes());
    Response::try_read(stream)
}

#[test]
fn idle_connections_without_token_block_nobody_with_one() {
    let files = Files::new();
    let mut options = files.options();
    options.connections = number(8);
    let server = Running::start(options);
    let (probe, query) = (Request::get("/healthz"), files.place.sealed(&truth()));
    let mut with_token = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    assert_eq!(ask(&mut with_token, &list).expect("an answer").status, 200);
    let mut unknown: Vec<TcpStream> = Vec::new();
    for _ in 0..40 {
        let mut stream = connect(server.address);
        assert_eq!(ask(&mut stream, &probe).expect("an answer").status, 200);
        unknown.push(stream);
    }
    // A newcomer with a token gets in and is answered; so is who was there before.
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(ask(&mut with_token, &list).expect("still there").status, 200);
    let open = unknown.iter_mut().filter_map(|stream| ask(stream, &probe)).count();
    assert!((1..=4).contains(&open), "half of eight are reserved, and {open} unknown clients are there");
    let text = server.get("/metrics", OPERATOR).text();
    assert!(text.contains("veiloc_connections_closed_total{reason=\"displaced\"}"), "{text}");
    // The operator is asked for no token, and has a listener that all of this does not reach.
    let admin = server.listening.admin.expect("a listener");
    assert_eq!(Request::get("/readyz").send(admin).text(), "ready\n");
    assert!(Request::get("/metrics").send(admin).text().contains("veiloc_connections "));
    assert_eq!(Request::localize(&query).token(PHONE).send(admin).status, 404, "it does not localize");
    assert_eq!(Request::get("/v1/maps").token(PHONE).send(admin).status, 404);
}

#[test]
fn a_connection_that_brings_no_token_does_not_live_long() {
    let files = Files::new();
    let mut options = files.options();
    options.timeouts.unknown_life = 5 * SECOND;
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
fn any_connection_ends_at_its_age() {
    let files = Files::new();
    let mut options = files.options();
    options.timeouts.life = 5 * SECOND;
    let server = Running::start_paused(options);
    let mut known = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    assert_eq!(ask(&mut known, &list).expect("an answer").status, 200);
    server.pass_until(SECOND, "the end of the connection", || ask(&mut known, &list).is_none());
}

#[test]
fn a_stuck_log_holds_up_no_request_and_refusals_are_summed_up() {
    common::alone::alone(
        "unknown_clients::a_stuck_log_holds_up_no_request_and_refusals_are_summed_up",
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
    // So that all of it is within a minute.
    let server = Running::start_paused(options);
    for _ in 0..100 {
        assert_eq!(server.get("/v1/maps", "guess").status, 401);
    }
    assert!(log.flush(Duration::from_secs(60)));
    let text = String::from_utf8(written.0.lock().expect("not poisoned").clone()).expect("text");
    let refusals = text.lines().filter(|line| line.contains("unauthenticated")).count();
    assert_eq!(refusals, 10, "of 100 refusals in a minute");

    // Nobody reads any more.
    let stuck = written.0.lock().expect("not poisoned");
    let lost = || server.get("/metrics", OPERATOR).text().contains("veiloc_log_lines_dropped_total 0");
    assert!(lost(), "nothing is lost yet");
    let mut stream = connect(server.address);
    let list = Request::get("/v1/maps").token(PHONE);
    for _ in 0..5000 {
        assert_eq!(ask(&mut stream, &list).expect("an answer").status, 200);
    }
    assert!(!lost(), "lines were dropped and counted");
    assert_eq!(server.stop().given_up, 0, "and it ends");
    drop(stuck);
    eventually("the log tells what is missing", || {
        let text = written.0.lock().expect("not poisoned").clone();
        String::from_utf8_lossy(&text).contains("log lines were dropped")
    });
}

#[test]
fn every_connection_reserved_is_refused() {
    let files = Files::new();
    let mut options = files.options();
    options.connections = number(8);
    options.reserved_connections = Some(8);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    let refused = runtime.block_on(Server::bind(options)).err();
    assert!(matches!(refused, Some(ServerError::Reserved { .. })), "{refused:?}");
}
