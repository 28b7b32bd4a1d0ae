//! Who gets the workers: a share for every token, time that ends, and work that nobody waits for any more.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use common::http::{Request, Response, connect};
use common::{Files, OPERATOR, PHONE, Running, eventually, truth};
use veiloc_service::ServerOptions;

fn one_worker(files: &Files, hypotheses: usize) -> ServerOptions {
    let mut options = files.options();
    options.workers = NonZeroUsize::MIN;
    options.queue = NonZeroUsize::new(8).expect("not zero");
    options.localize.pose.fixed_hypotheses = Some(hypotheses);
    options
}

fn busy(server: &Running) -> bool {
    server.get("/metrics", OPERATOR).text().contains("veiloc_workers_busy 1")
}

/// One token keeps its share of the queue full all the time; another asks now and then, and is answered every time.
#[test]
fn who_floods_the_queue_starves_nobody_else() {
    let files = Files::new();
    let server = Running::start(one_worker(&files, 300));
    let query = files.place.sealed(&truth());
    let (done, refused) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for _ in 0..12 {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    let status = server.localize(&query, OPERATOR).status;
                    assert!(matches!(status, 200 | 503), "{status}");
                    refused.fetch_add(usize::from(status == 503), Ordering::Relaxed);
                }
            });
        }
        eventually("a full share", || refused.load(Ordering::Relaxed) > 20);
        let victim: Vec<u16> = (0..10).map(|_| server.localize(&query, PHONE).status).collect();
        done.store(true, Ordering::Relaxed);
        assert_eq!(victim, [200; 10]);
    });
}

/// A search that would take for ever is stopped when its time is up, and the worker is free again.
#[test]
fn a_job_ends_with_its_time() {
    let files = Files::new();
    let mut options = one_worker(&files, usize::MAX);
    options.timeouts.localize = Duration::from_millis(200);
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    let response = server.localize(&query, PHONE);
    assert_eq!((response.status, response.problem().as_str()), (504, "timed-out"));
    eventually("a free worker", || !busy(&server));
    assert_eq!(server.localize(&query, PHONE).status, 504, "and the next one is taken");
}

/// The same when the client leaves, be it with bytes of another request behind its query.
#[test]
fn a_job_ends_when_its_client_leaves() {
    let files = Files::new();
    let mut options = one_worker(&files, usize::MAX);
    options.timeouts.localize = Duration::from_secs(3600);
    let server = Running::start(options);
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
fn what_would_be_late_is_not_begun() {
    const HYPOTHESES: usize = 100_000;
    let files = Files::new();
    // There is time for fifty, as fast as this machine is now, and ten times as many come.
    let query = files.place.sealed(&truth());
    let first = Running::start(one_worker(&files, HYPOTHESES));
    let begun = Instant::now();
    assert_eq!(first.localize(&query, PHONE).status, 200);
    let time = 50 * begun.elapsed();
    drop(first);
    let mut options = one_worker(&files, HYPOTHESES);
    options.timeouts.localize = time;
    options.queue = NonZeroUsize::new(4096).expect("not zero");
    let server = Running::start(options);
    // How long it takes is known from the first one on.
    assert_eq!(server.localize(&query, PHONE).status, 200);
    let request = Request::localize(&query).token(PHONE).bytes();
    // Many times more than is done within the time, all at once.
    let mut asked: Vec<_> = (0..500)
        .map(|_| {
            let mut stream = connect(server.address);
            stream.write_all(&request).expect("written");
            stream
        })
        .collect();
    // Which of them are late is the scheduler's choice: those that are told so at once.
    let refused = |stream: &TcpStream| {
        stream.set_read_timeout(Some(Duration::from_millis(1))).expect("set");
        let mut head = [0; 12];
        matches!(stream.peek(&mut head), Ok(12)) && &head == b"HTTP/1.1 503"
    };
    let mut found = None;
    eventually("one that would be late", || {
        found = asked.iter().position(refused);
        found.is_some()
    });
    let late = &mut asked[found.expect("it was found")];
    late.set_read_timeout(Some(Duration::from_secs(120))).expect("set");
    let late = Response::read(late);
    assert_eq!((late.status, late.problem().as_str()), (503, "overdue"));
    let after: u64 = late.header("retry-after").expect("a time").parse().expect("seconds");
    assert!((1..=60).contains(&after), "{after}");
    server.handle.stop_now();
}
