//! L8: no log line, metric or error contains any content of a query, a token, or parts of a requested address.
//!
//! This is one test in a separate process, because it captures everything that the process logs, at the finest level.

use super::common;

use std::io::Write;
use std::sync::{Arc, Mutex};

use common::http::Request;
use common::mark::{MARK, find_mark, marked};
use common::{Files, OPERATOR, PHONE, Running, truth};
use tracing_subscriber::fmt::MakeWriter;

#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Log {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().expect("not poisoned")).into_owned()
    }
}

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("not poisoned").write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

#[test]
fn l8_logs_and_metrics_contain_nothing_of_a_query() {
    common::own_process::run_in_own_process(
        "privacy::l8_logs_and_metrics_contain_nothing_of_a_query",
        check_logs_and_metrics,
    );
}

fn check_logs_and_metrics() {
    let log = Log::default();
    tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_writer(log.clone())
        .with_ansi(false)
        .init();
    // Check first that the search finds the mark in every form.
    for (form, text) in [
        ("text", String::from_utf8_lossy(MARK).into_owned()),
        ("hex", MARK.iter().fold(String::new(), |text, b| text + &format!("{b:02x}"))),
        ("a list", format!("{MARK:?}")),
        ("base64", "WHFadkt3Snk=".to_owned()),
    ] {
        tracing::trace!("{text}");
        assert!(find_mark(&log.text()).is_some(), "{form} is not found");
        log.0.lock().expect("not poisoned").clear();
    }

    let files = Files::new();
    let server = Running::start(files.options());
    let good = files.scene.sealed(&truth());
    let query = marked(&files);
    assert!(query.windows(16).any(|w| w == MARK), "the query contains the mark");
    let mark = std::str::from_utf8(MARK).expect("ASCII");
    let mut version = query.clone();
    version[1] = 9;
    let mut broken = query.clone();
    broken.truncate(query.len() - 7);
    let other = {
        let mut files = Files::new();
        files.scene.profile = common::TestScene::new(2).profile.clone();
        marked(&files)
    };
    let localize = |body: &[u8]| Request::localize(body).token(PHONE);
    let (mut output, mut ids) = (String::new(), Vec::new());
    for request in [
        localize(&query),
        localize(&good),
        localize(&version),
        localize(&broken),
        localize(&other),
        localize(MARK),
        localize(&MARK.repeat(60_000)),
        Request::localize(&query).token(mark),
        Request::localize(&query),
        Request::localize(&query).token(PHONE).header("x-mark", mark).header("accept", mark),
        Request::localize(&query).token(PHONE).header("cookie", mark),
        Request::localize(&query).token(PHONE).header("veiloc-request-id", mark).header("x-request-id", mark),
        Request::localize(&query).token(PHONE).header("traceparent", mark).header("tracestate", mark),
        Request::post(&format!("/v1/maps/{mark}/localize"), &query).token(PHONE),
        Request::post("/v1/maps/place/localize", &query).token(PHONE).header("content-type", mark),
        Request::post(&format!("/{mark}?{mark}"), &query).token(PHONE),
        Request::get(&format!("/v1/maps/place/profile?{mark}")).token(PHONE),
        Request { head: format!("{mark} /healthz HTTP/1.1\r\nhost: {mark}\r\n"), body: Vec::new() },
        Request { head: format!("GET / HTTP/1.1\r\n{mark}\r\n"), body: Vec::new() },
    ] {
        let response = request.send(server.address);
        output += &response.head;
        // Input that is not HTTP has no request id.
        ids.extend(response.header("veiloc-request-id").map(str::to_owned));
        output += &String::from_utf8_lossy(&response.body);
    }
    output += &server.get("/metrics", OPERATOR).text();
    drop(server);
    let logged = log.text();
    assert!(logged.lines().count() >= 15, "every request has a line:\n{logged}");
    assert!(logged.contains("sealed queries read") && logged.contains("wrong-profile"), "{logged}");
    assert_eq!(find_mark(&logged), None, "in the log:\n{logged}");
    assert_eq!(find_mark(&output), None, "in answers or metrics:\n{output}");
    // Each log line of a request has the request id of its response and the name of its token.
    assert_eq!(ids.len(), 18, "all requests except the malformed head");
    for id in &ids {
        let lines: Vec<_> = logged.lines().filter(|line| line.contains(&format!("request={id}"))).collect();
        assert!(lines.iter().any(|line| line.contains("answered")), "{id} is not in the log:\n{logged}");
    }
    let lines_of = |what: &str| logged.lines().filter(|line| line.contains(what)).collect::<Vec<_>>();
    let read = lines_of("sealed queries read");
    assert!(read.len() >= 4 && read.iter().all(|line| line.contains("request=")), "{read:?}");
    for line in lines_of("/localize\" status=200").iter().chain(&lines_of("problem=\"malformed-query\"")) {
        assert!(line.contains("token=\"someone\""), "{line}");
    }
    for line in lines_of("problem=\"unauthenticated\"") {
        assert!(!line.contains("token="), "{line}");
    }
    for token in [PHONE, OPERATOR] {
        assert!(!logged.contains(token) && !output.contains(token), "a token leaked");
    }
}
