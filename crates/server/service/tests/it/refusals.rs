//! Invalid requests and their refusals.

use super::common;

use std::io::Write as _;
use std::net::TcpStream;
use std::num::NonZeroUsize;
use std::sync::Arc;

use veiloc_service::{AnswerFuture, MapDescription, RemoteBackend, RemoteMap, RemoteRequest};

use common::gate::{Gate, wait_until_load};
use common::http::{Request, Response, connect, has_data};
use common::{Files, ManualClock, PHONE, Running, SECOND, TestScene, eventually, truth};

#[test]
fn invalid_requests_get_the_right_problem() {
    let files = Files::new();
    let server = Running::start(files.options());
    let query = files.scene.sealed(&truth());
    let other = TestScene::new(2).sealed(&truth());
    let mut next_version = query.clone();
    next_version[1] = 5;
    let mut cut = query.clone();
    cut.truncate(query.len() / 2);
    let longer = [&query[..], &[0x7D, 1, 2, 3, 4]].concat();
    let oversized = vec![0; 600_000];
    let localize = |body: &[u8]| Request::localize(body).token(PHONE);
    let post = |path: &str| Request::post(path, &query).token(PHONE);
    let protobuf = |request: Request| request.header("content-type", "application/x-protobuf");

    for (what, request, status, problem) in [
        ("no bytes", localize(&[]), 400, "malformed-query"),
        ("random bytes", localize(&[0xA5; 1000]), 400, "malformed-query"),
        ("cut in half", localize(&cut), 400, "malformed-query"),
        ("with a field more", localize(&longer), 400, "malformed-query"),
        ("of the next version", localize(&next_version), 400, "unsupported-version"),
        ("longer than any query", localize(&oversized), 413, "too-large"),
        ("sealed for another map", localize(&other), 409, "wrong-profile"),
        ("no token", Request::localize(&query), 401, "unauthenticated"),
        ("a wrong token", Request::localize(&query).token("guess"), 401, "unauthenticated"),
        ("no token, other bytes", Request::localize(&oversized), 401, "unauthenticated"),
        ("an unknown map", protobuf(post("/v1/maps/nowhere/localize")), 404, "unknown-map"),
        ("a name that is no text", protobuf(post("/v1/maps/%FF/localize")), 404, "unknown-map"),
        ("a way out", protobuf(post("/v1/maps/..%2F..%2Fplace/localize")), 404, "unknown-map"),
        ("an unknown address", post("/v2/anything"), 404, "not-found"),
        ("no media type", post("/v1/maps/place/localize"), 415, "media-type"),
        (
            "JSON",
            post("/v1/maps/place/localize").header("content-type", "application/json"),
            415,
            "media-type",
        ),
        ("compressed", localize(&query).header("content-encoding", "gzip"), 415, "media-type"),
        ("the wrong method", Request::get("/v1/maps/place/localize").token(PHONE), 405, "wrong-method"),
        ("a profile without token", Request::get("/v1/maps/place/profile"), 401, "unauthenticated"),
        ("an unknown profile", Request::get("/v1/maps/x/profile").token(PHONE), 404, "unknown-map"),
        ("the list without token", Request::get("/v1/maps"), 401, "unauthenticated"),
    ] {
        let response = request.send(server.address);
        assert_eq!((response.status, response.problem().as_str()), (status, problem), "{what}");
        if status == 401 {
            assert_eq!(response.header("www-authenticate"), Some("Bearer"), "{what}");
        }
        if status == 405 {
            assert_eq!(response.header("allow"), Some("POST"), "{what}");
        }
    }
    // The service still works afterwards.
    assert_eq!(server.localize(&query, PHONE).status, 200);
}

#[test]
fn out_of_map_image_is_not_localized() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    // Same vocabulary, other points.
    let mut negative = TestScene::new(2);
    negative.profile = files.scene.profile.clone();
    let response = server.localize(&negative.sealed(&truth()), "");
    if response.status == 200 {
        assert_eq!(response.json()["state"], "doubtful", "{}", response.text());
        assert!(!response.json()["doubts"].as_array().expect("a list").is_empty());
    } else {
        assert_eq!((response.status, response.problem().as_str()), (422, "not-localized"));
    }
}

#[test]
fn empty_map_is_reported() {
    let files = Files::new();
    veiloc_map::write(&files.scene.map(0), &files.path("place.vmap")).expect("written");
    let server = Running::start(files.open_options());
    let response = server.localize(&files.scene.sealed(&truth()), "");
    assert_eq!((response.status, response.problem().as_str()), (409, "empty-map"));
}

#[test]
fn exactly_one_host_is_needed() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let answer = |head: &str| {
        let request = Request { head: head.to_owned(), body: Vec::new() };
        let response = request.send(server.address);
        (response.status, if response.status == 200 { String::new() } else { response.problem() })
    };
    for head in ["GET /healthz HTTP/1.1\r\n", "GET /healthz HTTP/1.1\r\nhost: a\r\nhost: a\r\n"] {
        assert_eq!(answer(head), (400, "bad-host".to_owned()), "{head:?}");
    }
    assert_eq!(answer("GET /healthz HTTP/1.1\r\nhost: a\r\n").0, 200);
    assert_eq!(answer("GET /healthz HTTP/1.0\r\n").0, 200, "no such header then");
}

/// A gateway that has just started does not know its map yet, and soon will: clients come back in a second, not in the
/// half minute that an operator needs to mend a file.
#[test]
fn remote_map_that_is_not_known_yet_is_asked_for_again_soon() {
    struct Starting;
    impl RemoteBackend for Starting {
        fn describe(&self) -> Option<Arc<MapDescription>> {
            None
        }
        fn is_complete(&self) -> bool {
            false
        }
        fn localize(&self, _: RemoteRequest) -> AnswerFuture<'_> {
            unreachable!("no map, no query")
        }
    }
    let files = Files::new();
    let mut options = files.open_options();
    options.maps = Vec::new();
    options.remote_maps = vec![RemoteMap { name: "place".to_owned(), backend: Arc::new(Starting) }];
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    for response in [server.localize(&query, ""), server.get("/v1/maps/place/profile", "")] {
        assert_eq!((response.status, response.problem().as_str()), (503, "unreached"));
        assert_eq!(response.header("retry-after"), Some("1"));
    }
    assert_eq!(server.get("/readyz", "").status, 503);
}

/// Heads that are not HTTP, too long, or never end: an HTTP error or a closed connection, but never a hanging one.
#[test]
fn bad_heads_are_rejected() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.head = 5 * SECOND;
    let server = Running::start_paused(options);
    let long = format!("GET /healthz HTTP/1.1\r\nx: {}\r\n\r\n", "y".repeat(100_000));
    for (what, bytes) in [
        ("rubbish", b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n".to_vec()),
        ("a head of 100 kB", long.into_bytes()),
        ("a head that does not end", b"GET /healthz HTTP/1.1\r\nhost: t".to_vec()),
        ("nothing at all", Vec::new()),
    ] {
        let mut stream = connect(server.address);
        let _ = stream.write_all(&bytes);
        server.pass_until(SECOND, what, || has_data(&stream));
        if let Some(response) = Response::try_read(&mut stream) {
            assert!((400..500).contains(&response.status), "{what}: {response:?}");
        }
    }
    assert_eq!(server.get("/healthz", "").status, 200);
}

/// Head or body at one byte per second, as an attacker would do to occupy the server.
#[test]
fn slow_clients_are_disconnected() {
    let files = Files::new();
    let query = files.scene.sealed(&truth());
    let request = Request::localize(&query).bytes();
    let head = request.windows(4).position(|w| w == b"\r\n\r\n").expect("a head") + 4;
    for from in [head, 10] {
        let mut options = files.open_options();
        let limit = if from == head { &mut options.timeouts.body } else { &mut options.timeouts.head };
        *limit = 10 * SECOND;
        options.connections = NonZeroUsize::new(64).expect("not zero");
        let server = Running::start_paused(options);
        let mut slow: Vec<TcpStream> = (0..16).map(|_| connect(server.address)).collect();
        for stream in &mut slow {
            stream.write_all(&request[..from]).expect("written");
        }
        let mut rest = request[from..].iter();
        server.pass_until(SECOND, "an end of each", || {
            let next = rest.next().expect("it ends before all is written");
            let open: Vec<&mut TcpStream> = slow.iter_mut().filter(|stream| !has_data(stream)).collect();
            let all_ended = open.is_empty();
            for stream in open {
                // A connection that has just ended accepts nothing.
                let _ = stream.write_all(&[*next]);
            }
            all_ended
        });
        for mut stream in slow {
            let response = Response::try_read(&mut stream);
            if from == head {
                let response = response.expect("an answer");
                assert_eq!((response.status, response.problem().as_str()), (408, "too-slow"));
            } else {
                // Closed, with or without a response.
                assert!(response.is_none_or(|response| response.status == 408));
            }
        }
        assert_eq!(server.localize(&query, "").status, 200);
    }
}

#[test]
fn rate_limit_is_enforced() {
    let files = Files::new();
    let mut options = files.options();
    options.rate.per_second = 1.try_into().expect("not zero");
    options.rate.burst = 3.try_into().expect("not zero");
    let clock = ManualClock::new();
    options.clock = clock.clock();
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let ask = || server.localize(&query, PHONE);
    for _ in 0..3 {
        assert_eq!(ask().status, 200, "the first ones are within the limit");
    }
    let refused = |response: Response| {
        assert_eq!((response.status, response.problem().as_str()), (429, "rate-limited"));
        assert_eq!(response.header("retry-after"), Some("1"));
    };
    (0..9).for_each(|_| refused(ask()));
    clock.advance(SECOND);
    assert_eq!(ask().status, 200, "one per second");
    refused(ask());
    // A request without a valid token uses no rate limit, and another token has its own.
    assert_eq!(server.localize(&query, "guess").status, 401);
    assert_eq!(server.get("/v1/maps", common::OPERATOR).status, 200);
    assert_eq!(server.get("/healthz", "").status, 200);
}

/// More queries than fit: each gets a pose or a refusal.
#[test]
fn full_queue_refuses_and_accepted_queries_are_answered() {
    let files = Files::new();
    let mut options = files.open_options();
    options.threads = NonZeroUsize::MIN;
    options.queue = NonZeroUsize::MIN.saturating_add(1);
    let gate = Gate::install(&mut options);
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let mut streams: Vec<TcpStream> = (0..24).map(|_| connect(server.address)).collect();
    let (first, others) = streams.split_at_mut(1);
    first[0].write_all(&Request::localize(&query).bytes()).expect("written");
    wait_until_load(&server, 1, 0);
    for stream in others {
        stream.write_all(&Request::localize(&query).bytes()).expect("written");
    }
    // Two of them are queued; which ones is random.
    let refused = |streams: &[TcpStream]| streams.iter().filter(|stream| has_data(stream)).count();
    eventually("refusals", || refused(&streams) >= 21);
    wait_until_load(&server, 1, 2);
    assert_eq!(refused(&streams), 21);
    gate.open();
    let responses: Vec<Response> = streams.iter_mut().map(Response::read).collect();
    assert_eq!(responses.iter().filter(|r| r.status == 200).count(), 3);
    for response in responses.iter().filter(|r| r.status != 200) {
        assert_eq!((response.status, response.problem().as_str()), (503, "queue-full"));
        assert!(response.header("retry-after").is_some());
    }
    // The same bytes again, now that the queue has room.
    assert_eq!(server.localize(&query, "").status, 200);
}

#[test]
fn slow_localization_times_out() {
    let files = Files::new();
    let mut options = files.open_options();
    options.timeouts.localize = 10 * SECOND;
    options.localize.pose.fixed_hypotheses = Some(usize::MAX);
    let server = Running::start_paused(options);
    let mut stream = connect(server.address);
    stream.write_all(&Request::localize(&files.scene.sealed(&truth())).bytes()).expect("written");
    server.pass_until(SECOND, "an answer", || has_data(&stream));
    let response = Response::read(&mut stream);
    assert_eq!((response.status, response.problem().as_str()), (504, "timed-out"));
}
