//! Scheduling: fair shares of tokens, time limits, and cancelled work.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::{NonZeroU32, NonZeroUsize};

use common::gate::{Gate, wait_until_load};
use common::http::{Request, Response, connect};
use common::{Files, HOUR, ManualClock, OPERATOR, PHONE, Running, SECOND, eventually, truth};
use veiloc_service::ServerOptions;

fn one_worker(files: &Files) -> ServerOptions {
    let mut options = files.options();
    options.threads = NonZeroUsize::MIN;
    options.queue = NonZeroUsize::new(8).expect("not zero");
    options
}

/// Options with which every search runs until it is stopped.
fn endless(files: &Files) -> ServerOptions {
    let mut options = one_worker(files);
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    options
}

fn busy(server: &Running) -> bool {
    server.metric("veiloc_workers_busy") == Some(1.0)
}

/// Sends a request without waiting for the response.
fn ask(server: &Running, request: &Request) -> TcpStream {
    let mut stream = connect(server.address);
    stream.write_all(&request.bytes()).expect("written");
    stream
}

/// One token fills its share of the queue; another token still gets a slot and is answered second.
#[test]
fn fair_queue_isolates_tokens() {
    let files = Files::new();
    let mut options = one_worker(&files);
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let of = |token: &str| Request::localize(&query).token(token);
    let mut first = ask(&server, &of(OPERATOR));
    wait_until_load(&server, 1, 0);
    // A single lane may hold half of the queue.
    let waiting: Vec<TcpStream> = (0..4).map(|_| ask(&server, &of(OPERATOR))).collect();
    wait_until_load(&server, 1, 4);
    for _ in 0..12 {
        assert_eq!(server.localize(&query, OPERATOR).problem(), "queue-full");
    }
    let mut other = ask(&server, &of(PHONE));
    wait_until_load(&server, 1, 5);
    // The running query, and one turn of each lane.
    gate.admit(3);
    assert_eq!(Response::read(&mut first).status, 200);
    assert_eq!(Response::read(&mut other).status, 200);
    gate.open();
    for mut stream in waiting {
        assert_eq!(Response::read(&mut stream).status, 200);
    }
}

/// The queries of one client of a gateway fill the share of that client only. A phone cannot speak for others.
#[test]
fn queue_is_fair_between_the_clients_of_a_gateway() {
    const GATEWAY: &str = "gateway-token";
    let files = Files::new();
    let tokens = common::tokens_file(&[(GATEWAY, "gateway"), (PHONE, "")]);
    std::fs::write(files.path("tokens"), tokens).expect("written");
    let mut options = one_worker(&files);
    // Neither limit is for gateways.
    (options.rate.per_second, options.rate.burst) = (NonZeroU32::MIN, NonZeroU32::MIN);
    options.answer_quantum = HOUR;
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let client = |token: &str, digit: &str| {
        Request::localize(&query).token(token).header("veiloc-client", &digit.repeat(64))
    };
    let mut first = ask(&server, &client(GATEWAY, "a"));
    wait_until_load(&server, 1, 0);
    let waiting: Vec<TcpStream> = (0..4).map(|_| ask(&server, &client(GATEWAY, "a"))).collect();
    wait_until_load(&server, 1, 4);
    assert_eq!(client(GATEWAY, "a").send(server.address).problem(), "queue-full");
    let mut other = ask(&server, &client(GATEWAY, "b"));
    wait_until_load(&server, 1, 5);
    assert_eq!(client(GATEWAY, "").send(server.address).problem(), "bad-option");
    // What a phone says there is not even read.
    let _phone = ask(&server, &client(PHONE, "?"));
    wait_until_load(&server, 1, 6);
    // The running query, and one turn of each lane.
    gate.admit(4);
    assert_eq!(Response::read(&mut first).status, 200);
    assert_eq!(Response::read(&mut other).status, 200);
    gate.open();
    for mut stream in waiting {
        assert_eq!(Response::read(&mut stream).status, 200);
    }
}

/// A search without end is stopped at its time limit, and the worker becomes free.
#[test]
fn job_is_stopped_at_its_time_limit() {
    let files = Files::new();
    let mut options = endless(&files);
    options.timeouts.localize = 10 * SECOND;
    let server = Running::start_paused(options);
    let query = files.scene.sealed(&truth());
    for _ in 0..2 {
        let mut stream = ask(&server, &Request::localize(&query).token(PHONE));
        eventually("work", || busy(&server));
        server.pass(10 * SECOND);
        let response = Response::read(&mut stream);
        assert_eq!((response.status, response.problem().as_str()), (504, "timed-out"));
        eventually("a free worker", || !busy(&server));
    }
}

/// The same when the client disconnects, also with bytes of another request behind its query.
#[test]
fn job_is_cancelled_when_the_client_disconnects() {
    let files = Files::new();
    let server = Running::start(endless(&files));
    let query = Request::localize(&files.scene.sealed(&truth())).token(PHONE).bytes();
    for behind in [b"".as_slice(), b"GET /healthz HTTP/1.1\r\nhost: test\r\n\r\n", b"GET /he"] {
        let mut stream = connect(server.address);
        stream.write_all(&[&query, behind].concat()).expect("written");
        eventually("work", || busy(&server));
        drop(stream);
        eventually("a free worker", || !busy(&server));
    }
}

/// A query that cannot finish in time is refused at once, with a useful `Retry-After`.
#[test]
fn queries_that_would_be_late_are_refused() {
    let files = Files::new();
    let mut options = one_worker(&files);
    let (gate, clock) = (Gate::install(&mut options), ManualClock::new());
    options.clock = clock.clock();
    // A query takes an hour. Behind half a query and a whole one it would end ten seconds late.
    options.timeouts.localize = (HOUR + HOUR / 2).saturating_sub(10 * SECOND);
    let server = Running::start_paused(options);
    let query = files.scene.sealed(&truth());
    let request = Request::localize(&query).token(PHONE);
    let mut first = ask(&server, &request);
    wait_until_load(&server, 1, 0);
    clock.advance(HOUR);
    gate.admit(1);
    assert_eq!(Response::read(&mut first).status, 200);
    wait_until_load(&server, 0, 0);
    let mut second = ask(&server, &request);
    wait_until_load(&server, 1, 0);
    let mut third = ask(&server, &request);
    wait_until_load(&server, 1, 1);
    let late = server.localize(&query, PHONE);
    assert_eq!((late.status, late.problem().as_str()), (503, "overdue"));
    let after: u64 = late.header("retry-after").expect("a time").parse().expect("seconds");
    // Half of an odd number of rows is rounded down.
    assert!((8..=10).contains(&after), "{after}");
    // Accepted queries are answered.
    gate.open();
    for stream in [&mut second, &mut third] {
        assert_eq!(Response::read(stream).status, 200);
    }
}
