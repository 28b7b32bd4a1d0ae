//! L12: answers leave at whole quanta of time after the query was received, with a pose and without one.

use super::common;

use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use common::gate::{Gate, wait_until_load};
use common::http::{Request, Response, connect, has_data};
use common::{Files, Running, SECOND, eventually, truth};

const QUANTUM: Duration = Duration::from_secs(10);
/// A moment less than the quantum.
const ALMOST: Duration = Duration::from_millis(9_999);
const MOMENT: Duration = Duration::from_millis(1);

fn send(server: &Running, query: &[u8]) -> TcpStream {
    let mut stream = connect(server.address);
    stream.write_all(&Request::localize(query).bytes()).expect("written");
    stream
}

/// Waits until this many queries were localized, with or without a pose.
fn wait_until_localized(server: &Running, count: u32) {
    let series = "veiloc_stage_seconds_count{stage=\"queue\"}";
    eventually("the end of the work", || server.metric(series) == Some(f64::from(count)));
}

/// Answers that are not held have left by the time that the service answers another request.
fn is_held(server: &Running, stream: &TcpStream) -> bool {
    assert_eq!(server.get("/healthz", "").status, 200);
    !has_data(stream)
}

fn read(mut stream: TcpStream) -> Response {
    eventually("the answer", || has_data(&stream));
    Response::read(&mut stream)
}

#[test]
fn l12_answers_with_and_without_pose_leave_at_one_time() {
    let files = Files::new();
    let mut options = files.open_options();
    options.answer_quantum = QUANTUM;
    let server = Running::start_paused(options);
    let queries = [
        files.scene.sealed(&truth()),
        files.scene.sealed_without_features(),
        files.scene.sealed_without_consensus(),
    ];
    let streams = queries.map(|query| send(&server, &query));
    wait_until_localized(&server, 3);
    assert!(streams.iter().all(|stream| is_held(&server, stream)), "before the first quantum has passed");
    server.pass(ALMOST);
    assert!(streams.iter().all(|stream| is_held(&server, stream)), "a moment before its end");
    server.pass(2 * MOMENT);
    let statuses = streams.map(|stream| read(stream).status);
    assert_eq!(statuses, [200, 422, 422]);
    assert_eq!(server.metric("veiloc_late_answers_total"), Some(0.0));
}

/// An answer that takes longer leaves at the end of a later quantum and is counted. A refusal that depends on the load
/// alone leaves at once.
#[test]
fn l12_later_answers_leave_at_a_later_quantum() {
    let files = Files::new();
    let mut options = files.open_options();
    options.answer_quantum = QUANTUM;
    options.threads = 1.try_into().expect("not zero");
    options.queue = 1.try_into().expect("not zero");
    let gate = Gate::install(&mut options);
    let server = Running::start_paused(options);
    let query = files.scene.sealed(&truth());
    let first = send(&server, &query);
    wait_until_load(&server, 1, 0);
    let second = send(&server, &query);
    wait_until_load(&server, 1, 1);
    let refused = read(send(&server, &query));
    assert_eq!(refused.problem(), "queue-full");

    server.pass(QUANTUM + 3 * SECOND);
    gate.open();
    wait_until_localized(&server, 2);
    assert!(is_held(&server, &first) && is_held(&server, &second));
    server.pass(6 * SECOND);
    assert!(is_held(&server, &first) && is_held(&server, &second), "19 s after the query");
    server.pass(SECOND + MOMENT);
    assert_eq!([read(first).status, read(second).status], [200, 200]);
    assert_eq!(server.metric("veiloc_late_answers_total"), Some(2.0));
}
