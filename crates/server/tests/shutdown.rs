//! Stopping: what was accepted is answered, and nothing is waited for longer than the grace period.

mod common;

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
        assert_eq!(server.stop(), 0, "no connection was given up");
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
    assert_eq!(server.stop(), 1);
}
