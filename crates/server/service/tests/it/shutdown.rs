//! Stopping: what was accepted is answered, and nothing is waited for longer than the grace period.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::NonZeroUsize;
use std::time::Duration;

use common::http::{Request, Response, connect};
use common::{Files, OPERATOR, Running, eventually, truth};

#[test]
fn accepted_requests_are_answered() {
    let files = Files::new();
    let mut options = files.open_options();
    options.workers = NonZeroUsize::MIN;
    options.localize.pose.fixed_hypotheses = Some(1000);
    let server = Running::start(options);
    let address = server.address;
    let query = files.place.sealed(&truth());
    let mut idle = connect(address);
    std::thread::scope(|scope| {
        let asked: Vec<_> = (0..8)
            .map(|_| {
                let query = &query;
                scope.spawn(move || Request::localize(query).send(address))
            })
            .collect();
        eventually("all eight are accepted", || {
            let text = Request::get("/metrics").token(OPERATOR).send(address).text();
            let value = |name: &str| -> u64 {
                let line = text.lines().find_map(|l| l.strip_prefix(name)).expect("a gauge");
                line.trim().parse().expect("a number")
            };
            let answered: u64 = text
                .lines()
                .find_map(|l| l.strip_prefix("veiloc_stage_seconds_count{stage=\"queue\"} "))
                .map_or(0, |n| n.parse().expect("a number"));
            value("veiloc_queue_length ") + value("veiloc_workers_busy ") + answered >= 8
        });
        let stopped = server.stop();
        assert_eq!(stopped.given_up, 0, "no connection was given up");
        assert!(stopped.answered <= 8 && !stopped.forced, "{stopped:?}");
        for one in asked {
            assert_eq!(one.join().expect("an answer").status, 200);
        }
    });
    // An idle connection was closed, and no new one is taken.
    assert!(Response::try_read(&mut idle).is_none());
    assert!(TcpStream::connect(address).is_err());
}

#[test]
fn who_does_not_end_is_given_up() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.grace = Duration::from_millis(200);
    let server = Running::start(options);
    let request = Request::localize(&files.place.sealed(&truth())).bytes();
    let mut stream = connect(server.address);
    stream.write_all(&request[..request.len() / 2]).expect("written");
    // The server has seen it: another connection is answered after it.
    eventually("the connection", || {
        Request::get("/metrics").send(server.address).text().contains("veiloc_connections 2")
    });
    assert_eq!(server.stop().given_up, 1);
}

/// Told to stop, it says so first, and goes on answering until balancers have had time to look elsewhere.
#[test]
fn readiness_ends_before_the_listener_does() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.drain = Duration::from_secs(3600);
    options.admin = Some("127.0.0.1:0".parse().expect("an address"));
    let server = Running::start(options);
    let (address, admin) = (server.address, server.listening.admin.expect("a listener"));
    let query = files.place.sealed(&truth());
    let mut kept = connect(address);
    let mut ask = |request: &Request| {
        kept.write_all(&request.bytes()).expect("written");
        Response::try_read(&mut kept)
    };
    assert_eq!(ask(&Request::get("/readyz")).expect("an answer").status, 200);
    server.handle.stop();
    for at in [address, admin] {
        let response = Request::get("/readyz").send(at);
        assert_eq!((response.status, response.text().as_str()), (503, "stopping\n"));
    }
    assert_eq!(Request::localize(&query).send(address).status, 200, "who comes is still answered");
    let last = ask(&Request::localize(&query)).expect("an answer");
    assert_eq!((last.status, last.header("connection")), (200, Some("close")));
    assert!(ask(&Request::get("/readyz")).is_none(), "a connection that is kept is closed in order");
    eventually("connections that were answered are closed", || {
        Request::get("/metrics").send(admin).text().contains("veiloc_connections 0\n")
    });
    server.handle.stop_now();
    let stopped = server.stop();
    assert_eq!(
        (stopped.given_up, stopped.answered, stopped.forced),
        (0, 3, true),
        "probes of the operator do not count"
    );
}

/// A job that would never end: told a second time, the service ends all the same, and so it does after its grace.
#[test]
fn what_never_ends_does_not_keep_it() {
    for forced in [false, true] {
        let files = Files::new();
        let mut options = files.open_options();
        options.workers = NonZeroUsize::MIN;
        options.localize.pose.fixed_hypotheses = Some(usize::MAX);
        options.timeouts.localize = Duration::from_secs(3600);
        options.timeouts.grace = Duration::from_secs(if forced { 3600 } else { 0 });
        let server = Running::start(options);
        let mut stream = connect(server.address);
        stream.write_all(&Request::localize(&files.place.sealed(&truth())).bytes()).expect("written");
        eventually("work", || server.get("/metrics", OPERATOR).text().contains("veiloc_workers_busy 1"));
        server.handle.stop();
        if forced {
            server.handle.stop_now();
        }
        let stopped = server.stop();
        // The connection that asked for metrics may be closing still.
        assert!((1..=2).contains(&stopped.given_up), "{}", stopped.given_up);
        assert_eq!(stopped.forced, forced);
        assert!(Response::try_read(&mut stream).is_none());
    }
}
