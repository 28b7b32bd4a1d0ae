//! Shutdown: accepted requests are answered, within the grace period.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::NonZeroUsize;
use std::time::Duration;

use common::gate::{Gate, wait_until_load};
use common::http::{Request, Response, connect};
use common::{Files, HOUR, Running, eventually, truth};

#[test]
fn accepted_requests_are_answered() {
    let files = Files::new();
    let mut options = files.open_options();
    options.threads = NonZeroUsize::MIN;
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let address = server.address;
    let query = files.scene.sealed(&truth());
    let mut idle = connect(address);
    let mut streams: Vec<TcpStream> = (0..8).map(|_| connect(address)).collect();
    for stream in &mut streams {
        stream.write_all(&Request::localize(&query).bytes()).expect("written");
    }
    wait_until_load(&server, 1, 7);
    server.handle.stop();
    gate.open();
    let stopped = server.stop();
    assert_eq!((stopped.answered, stopped.given_up, stopped.forced), (8, 0, false));
    for mut stream in streams {
        assert_eq!(Response::read(&mut stream).status, 200);
    }
    // The idle connection was closed, and no new one is accepted.
    assert!(Response::try_read(&mut idle).is_none());
    assert!(TcpStream::connect(address).is_err());
}

#[test]
fn unfinished_connections_are_closed_after_the_grace_period() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.grace = Duration::ZERO;
    let server = Running::start(options);
    let request = Request::localize(&files.scene.sealed(&truth())).bytes();
    let mut stream = connect(server.address);
    stream.write_all(&request[..request.len() / 2]).expect("written");
    eventually("the connection", || server.metric("veiloc_connections") == Some(1.0));
    assert_eq!(server.stop().given_up, 1);
}

/// A stopping service announces it and still answers until load balancers have redirected clients.
#[test]
fn readiness_ends_before_the_listener_closes() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.drain = HOUR;
    let server = Running::start(options);
    let (address, admin) = (server.address, server.listening.admin.expect("a listener"));
    let query = files.scene.sealed(&truth());
    let mut persistent = connect(address);
    let mut ask = |request: &Request| {
        persistent.write_all(&request.bytes()).expect("written");
        Response::try_read(&mut persistent)
    };
    assert_eq!(ask(&Request::get("/readyz")).expect("an answer").status, 200);
    server.handle.stop();
    for at in [address, admin] {
        let response = Request::get("/readyz").send(at);
        assert_eq!((response.status, response.text().as_str()), (503, "stopping\n"));
    }
    assert_eq!(Request::localize(&query).send(address).status, 200, "new connections are still answered");
    let last = ask(&Request::localize(&query)).expect("an answer");
    assert_eq!((last.status, last.header("connection")), (200, Some("close")));
    assert!(ask(&Request::get("/readyz")).is_none(), "a persistent connection is closed after its response");
    eventually("an end of connections that were answered", || {
        server.metric("veiloc_connections") == Some(0.0)
    });
    server.handle.stop_now();
    let stopped = server.stop();
    assert_eq!(
        (stopped.given_up, stopped.answered, stopped.forced),
        (0, 3, true),
        "probes of the operator do not count"
    );
}

/// A job without end is stopped by a second stop request, or after the grace period.
#[test]
fn endless_jobs_do_not_block_shutdown() {
    for forced in [false, true] {
        let files = Files::new();
        let mut options = files.open_options();
        options.threads = NonZeroUsize::MIN;
        options.localize.pose.fixed_hypotheses = Some(usize::MAX);
        options.timeouts.grace = if forced { HOUR } else { Duration::ZERO };
        let server = Running::start(options);
        let mut stream = connect(server.address);
        stream.write_all(&Request::localize(&files.scene.sealed(&truth())).bytes()).expect("written");
        eventually("work", || server.metric("veiloc_workers_busy") == Some(1.0));
        server.handle.stop();
        if forced {
            server.handle.stop_now();
        }
        let stopped = server.stop();
        assert_eq!((stopped.given_up, stopped.forced), (1, forced));
        assert!(Response::try_read(&mut stream).is_none());
    }
}
