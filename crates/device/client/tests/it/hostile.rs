//! Responses are not trusted: too long, of the wrong type, with control characters.

use super::common;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Service, known, problem, protobuf, query, quick, recording, reply};
use veiloc_client::{Answer, AnswerState, Client, ClientError, LocalizeRequest, Notice, Profile};

fn bad_answer(replies: Vec<Vec<u8>>) -> String {
    let service = Service::replying(replies);
    match service.client().localize("place", &query()) {
        Err(error @ ClientError::BadAnswer { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn invalid_answers_are_rejected() {
    let good = known("without-fit.answer");
    let html = reply("200 OK", &[("content-type", "text/html\u{1b}[2J")], b"<h1>Welcome to the hotel</h1>");
    assert!(
        bad_answer(vec![reply("200 OK", &[("content-type", "text/html")], b"<h1>Hotel</h1>")])
            .contains("text/html")
    );
    assert!(bad_answer(vec![reply("200 OK", &[], &good)]).contains("not protobuf"), "no type at all");
    assert!(
        !format!("{:?}", Service::replying(vec![html]).client().localize("p", &query())).contains('\u{1b}')
    );
    for body in [&b""[..], &good[..good.len() - 1], &[good.clone(), vec![0]].concat(), &[0xA5; 300]] {
        bad_answer(vec![protobuf(body)]);
    }
    // A billion bytes, announced or endless: the client stops at its limit.
    let announced =
        b"HTTP/1.1 200 OK\r\ncontent-type: application/x-protobuf\r\ncontent-length: 1000000000\r\n\r\n";
    assert!(bad_answer(vec![[&announced[..], &vec![0; 200_000]].concat()]).contains("longer than"));
    let endless = b"HTTP/1.1 200 OK\r\ncontent-type: application/x-protobuf\r\nconnection: close\r\n\r\n";
    assert!(bad_answer(vec![[&endless[..], &vec![0; 200_000]].concat()]).contains("longer than"));
    let refusal = [&b"HTTP/1.1 422 No\r\nconnection: close\r\n\r\n"[..], &vec![b'['; 200_000]].concat();
    assert!(bad_answer(vec![refusal]).contains("longer than"));
}

#[test]
fn invalid_headers_are_rejected() {
    for head in [
        b"\x16\x03\x01\x02\x00\x01\x00".to_vec(),
        b"HTTP/9.9 1000 What\r\n\r\n".to_vec(),
        [&b"HTTP/1.1 200 OK\r\nx: "[..], &vec![b'y'; 1_000_000], b"\r\n\r\n"].concat(),
    ] {
        let service = Service::replying(vec![head]);
        let mut options = quick();
        options.retry.retries = 0;
        let client = Client::new(&service.url, None, options).expect("a client");
        let error = client.localize("place", &query()).expect_err("no HTTP");
        assert!(matches!(error, ClientError::Network { .. }), "{error:?}");
    }
}

/// Texts of an error response or a doubt are safe for a terminal.
#[test]
fn service_texts_are_printable() {
    let body = "{\"title\":\"\\u001b[2J\\u001b]0;owned\\u0007\",\"detail\":\"line\\r\\nline\\u202eend\",\"type\":\"\\u001b\"}";
    let service = Service::replying(vec![reply("403 No", &[], body.as_bytes())]);
    let error = service.client().localize("place", &query()).expect_err("refused");
    let ClientError::Refused(refusal) = &error else { panic!("{error:?}") };
    assert_eq!((refusal.title.as_str(), refusal.detail.as_str()), ("[2J]0;owned", "linelineend"));
    let wordy = format!("{{\"title\":\"t\",\"detail\":\"{}\"}}", "x".repeat(60_000));
    let service = Service::replying(vec![reply("403 No", &[], wordy.as_bytes())]);
    let error = service.client().localize("place", &query()).expect_err("refused");
    assert!(error.to_string().len() < 600, "{} characters", error.to_string().len());

    let mut answer = Answer::decode(&known("without-fit.answer")).expect("a known answer");
    answer.doubts[0].text = "\u{1b}[31mno\u{9b}2J\u{2066}doubt\n".to_owned();
    let service = Service::replying(vec![protobuf(&answer.encode())]);
    let answer = service.client().localize("place", &query()).expect("an answer");
    assert_eq!(answer.doubts[0].text, "[31mno2Jdoubt");
}

#[test]
fn invalid_retry_after_is_ignored() {
    for nonsense in ["-1", "soon", "1e9", "99999999999999999999999999"] {
        let busy = problem("503 Busy", "queue-full", &[("retry-after", nonsense)]);
        let service = Service::replying(vec![busy, protobuf(&known("without-fit.answer"))]);
        let (options, pauses) = recording();
        let client = Client::new(&service.url, None, options).expect("a client");
        client.localize("place", &query()).expect("after a short pause");
        assert_eq!(*pauses.lock().expect("not poisoned"), [Duration::from_millis(500)], "{nonsense}");
    }
}

#[test]
fn profiles_are_cached_revalidated_and_checked() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let good = known("sift.profile");
    let profile = Profile::decode(&good).expect("a known answer");
    let mut options = quick();
    options.cache = Some(folder.path().to_owned());
    options.retry.retries = 0;
    let not_modified = reply("304 Not Modified", &[], b"");
    let service = Service::replying(vec![
        not_modified.clone(),
        protobuf(b"no profile"),
        reply("200 OK", &[("content-type", "text/html")], &good),
        protobuf(&good),
        not_modified.clone(),
        protobuf(&good),
    ]);
    let client = Client::new(&service.url, None, options.clone()).expect("a client");
    let fetch = || client.profile("place");
    assert!(
        matches!(fetch(), Err(ClientError::Refused(r)) if r.status == 304),
        "the request was not conditional"
    );
    assert!(matches!(fetch(), Err(ClientError::BadAnswer { .. })));
    assert!(matches!(fetch(), Err(ClientError::BadAnswer { .. })));
    assert_eq!(std::fs::read_dir(folder.path()).expect("there").count(), 0, "nothing was cached");
    assert_eq!(fetch().expect("fetched"), profile);
    assert_eq!(fetch().expect("confirmed"), profile);
    let cached = std::fs::read_dir(folder.path().join("profiles")).expect("there").next().expect("a file");
    let cached = cached.expect("an entry").path();
    assert!(std::fs::read(&cached).expect("kept") == good);
    std::fs::write(&cached, b"damaged").expect("written");
    assert_eq!(fetch().expect("fetched again"), profile);
    let tagged: Vec<bool> = service.requests().iter().map(|a| a.head.contains("if-none-match")).collect();
    assert_eq!(tagged, [false, false, false, false, true, false]);
    assert!(std::fs::read(&cached).expect("kept") == good, "whole again");
    // Names with path separators reach neither the folder nor the address.
    for name in ["..", "../x", "a/b", "a?b", ""] {
        assert!(matches!(client.profile(name), Err(ClientError::MapName { .. })), "{name}");
    }
}

/// A service that gives a device another profile than before, or than the published one, is noticed before anything is
/// sealed.
#[test]
fn another_profile_is_refused_or_reported() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let good = known("sift.profile");
    let own = Profile::decode(&good).expect("a profile");
    let limits = veiloc_protocol::ExtractionLimits { max_image_side: 1599, ..own.limits() };
    let other = own.clone().with_limits(limits).expect("allowed");
    assert_ne!(own.id(), other.id());
    let changes = Arc::new(Mutex::new(Vec::new()));
    let mut options = quick();
    options.cache = Some(folder.path().to_owned());
    let kept = changes.clone();
    options.notice = Some(Arc::new(move |notice: &Notice| kept.lock().expect("whole").push(notice.clone())));
    let service = Service::replying(vec![
        protobuf(&good),
        protobuf(&good),
        protobuf(&other.encode()),
        reply("304 Not Modified", &[], b""),
        protobuf(&good),
    ]);
    let client = Client::new(&service.url, None, options.clone()).expect("a client");
    for expected in [&own, &own, &other] {
        assert_eq!(client.profile("place").expect("fetched"), *expected);
    }
    let change =
        Notice::Changed { what: "profile", map: "place".to_owned(), before: own.id(), now: other.id() };
    assert_eq!(*changes.lock().expect("whole"), [change], "once, when it changed");
    // The same with the id of the first one: also a cached profile is refused, and the other map is not concerned.
    options.profile_ids.insert("place".to_owned(), own.id());
    options.profile_ids.insert("elsewhere".to_owned(), other.id());
    let pinned = Client::new(&service.url, None, options).expect("a client");
    match pinned.profile("place") {
        Err(ClientError::OtherId { map, expected, actual, .. }) => {
            assert_eq!((map.as_str(), expected, actual), ("place", own.id(), other.id()));
        }
        unexpected => panic!("{unexpected:?}"),
    }
    assert_eq!(pinned.profile("place").expect("the published one"), own);
}

/// Request options are sent, also with every retry; the client removes what it did not request.
#[test]
fn request_options_are_sent_and_enforced() {
    let busy = problem("503 Busy", "queue-full", &[("retry-after", "0")]);
    // A pose although it was not requested, as from a service that does not know the option.
    let service = Service::replying(vec![
        busy,
        protobuf(&known("without-fit.answer")),
        protobuf(&known("withheld.answer")),
    ]);
    let client = service.client();
    let mut request = LocalizeRequest::default();
    request.trusted_only = true;
    request.near = Some("1,2,-3,0.5".parse().expect("a place"));
    for _ in 0..2 {
        let answer = client.localize_with("place", &query(), &request).expect("an answer");
        assert_eq!((answer.pose, answer.state(), answer.doubts.len()), (None, AnswerState::Doubtful, 2));
    }
    let requests = service.requests();
    for sent in &requests {
        let of = |name: &str| sent.head.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        assert_eq!(of("veiloc-trusted-only:"), Some("true"));
        assert_eq!(of("veiloc-near:").and_then(|text| text.parse().ok()), request.near);
    }
    assert_eq!((requests.len(), requests[0].body == requests[2].body), (3, true));

    let service = Service::replying(vec![protobuf(&known("doubtful.answer"))]);
    let answer = service.client().localize("place", &query()).expect("an answer");
    assert!(answer.pose.is_some() && answer.fit.is_some());
    assert!(!service.requests()[0].head.contains("veiloc-"), "no option is sent by default");
}
