//! Who gets the workers: a share for every token, time that ends, and work that nobody waits for any more.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::NonZeroUsize;

use common::gate::{Gate, all_are_in};
use common::http::{Request, Response, connect};
use common::{Files, HOUR, ManualClock, OPERATOR, PHONE, Running, SECOND, eventually, truth};
use veiloc_service::ServerOptions;

fn one_worker(files: &Files) -> ServerOptions {
    let mut options = files.options();
    options.workers = NonZeroUsize::MIN;
    options.queue = NonZeroUsize::new(8).expect("not zero");
    options
}

/// Every search goes on until it is stopped.
fn endless(files: &Files) -> ServerOptions {
    let mut options = one_worker(files);
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    options
}

fn busy(server: &Running) -> bool {
    server.metric("veiloc_workers_busy") == Some(1.0)
}

/// Sends a request; its answer comes later.
fn ask(server: &Running, request: &Request) -> TcpStream {
    let mut stream = connect(server.address);
    stream.write_all(&request.bytes()).expect("written");
    stream
}

/// One token fills its share of the queue; another one finds room, and is answered second.
#[test]
fn fair_queue_isolates_tokens() {
    let files = Files::new();
    let mut options = one_worker(&files);
    let gate = Gate::before_the_map_of(&files, &mut options);
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    let of = |token: &str| Request::localize(&query).token(token);
    let mut first = ask(&server, &of(OPERATOR));
    all_are_in(&server, 1, 0);
    // A lane alone may hold half of the queue.
    let waiting: Vec<TcpStream> = (0..4).map(|_| ask(&server, &of(OPERATOR))).collect();
    all_are_in(&server, 1, 4);
    for _ in 0..12 {
        assert_eq!(server.localize(&query, OPERATOR).problem(), "queue-full");
    }
    let mut other = ask(&server, &of(PHONE));
    all_are_in(&server, 1, 5);
    // The one at work, and one turn of each lane.
    gate.let_through(3);
    assert_eq!(Response::read(&mut first).status, 200);
    assert_eq!(Response::read(&mut other).status, 200);
    gate.open();
    for mut stream in waiting {
        assert_eq!(Response::read(&mut stream).status, 200);
    }
}

/// A search that would take for ever is stopped when its time is up, and the worker is free again.
#[test]
fn a_job_ends_with_its_time() {
    let files = Files::new();
    let mut options = endless(&files);
    options.timeouts.localize = 10 * SECOND;
    let server = Running::start_paused(options);
    let query = files.place.sealed(&truth());
    for _ in 0..2 {
        let mut stream = ask(&server, &Request::localize(&query).token(PHONE));
        eventually("work", || busy(&server));
        server.pass(10 * SECOND);
        let response = Response::read(&mut stream);
        assert_eq!((response.status, response.problem().as_str()), (504, "timed-out"));
        eventually("a free worker", || !busy(&server));
    }
}

/// The same when the client leaves, be it with bytes of another request behind its query.
#[test]
fn a_job_ends_when_its_client_leaves() {
    let files = Files::new();
    let server = Running::start(endless(&files));
    let query = Request::localize(&files.place.sealed(&truth())).token(PHONE).bytes();
    for behind in [b"".as_slice(), b"GET /healthz HTTP/1.1\r\nhost: test\r\n\r\n", b"GET /he"] {
        let mut stream = connect(server.address);
        stream.write_all(&[&query, behind].concat()).expect("written");
        eventually("work", || busy(&server));
        drop(stream);
        eventually("a free worker", || !busy(&server));
    }
}

/// What cannot be done in time is refused at once, and with a time that is worth waiting for.
#[test]
fn queries_that_would_be_late_are_refused() {
    let files = Files::new();
    let mut options = one_worker(&files);
    let (gate, clock) = (Gate::before_the_map_of(&files, &mut options), ManualClock::new());
    options.clock = clock.clock();
    // A query takes an hour. Behind half a one and a whole one it would end ten seconds late.
    options.timeouts.localize = (HOUR + HOUR / 2).saturating_sub(10 * SECOND);
    let server = Running::start_paused(options);
    let query = files.place.sealed(&truth());
    let request = Request::localize(&query).token(PHONE);
    let mut first = ask(&server, &request);
    all_are_in(&server, 1, 0);
    clock.advance(HOUR);
    gate.let_through(1);
    assert_eq!(Response::read(&mut first).status, 200);
    all_are_in(&server, 0, 0);
    let mut second = ask(&server, &request);
    all_are_in(&server, 1, 0);
    let mut third = ask(&server, &request);
    all_are_in(&server, 1, 1);
    let late = server.localize(&query, PHONE);
    assert_eq!((late.status, late.problem().as_str()), (503, "overdue"));
    let after: u64 = late.header("retry-after").expect("a time").parse().expect("seconds");
    // Half of an odd number of rows is rounded down.
    assert!((8..=10).contains(&after), "{after}");
    // Those that were taken are answered.
    gate.open();
    for stream in [&mut second, &mut third] {
        assert_eq!(Response::read(stream).status, 200);
    }
}
