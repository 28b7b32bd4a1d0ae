//! L7: what is sent again is what was sent before, and only when that may help.

use super::common;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Service, known, problem, protobuf, query, quick, recording, reply};
use veiloc_client::{CameraFromRig, Client, ClientError, LocalizeRequest, Notice, RigMessage, SealedFrame};

#[test]
fn a_retry_sends_the_same_bytes() {
    let service = Service::saying(vec![
        problem("503 Busy", "queue-full", &[("retry-after", "0")]),
        Vec::new(),
        problem("429 Slow down", "rate-limited", &[("retry-after", "0")]),
        reply("504 Late", &[], b""),
        // Breaks off in the middle of its answer.
        protobuf(&known("without-fit.answer"))[..3000].to_vec(),
        protobuf(&known("without-fit.answer")),
    ]);
    let notices = Arc::new(Mutex::new(Vec::new()));
    let kept = notices.clone();
    let mut options = quick();
    options.retry.retries = 5;
    options.notice = Some(Arc::new(move |notice: &Notice| {
        kept.lock().expect("not poisoned").push(notice.clone());
    }));
    let client = Client::new(&service.url, Some("the-token"), options).expect("a client");
    let answer = client.localize("place", &query()).expect("at last");
    assert_eq!(answer.inliers, 311);
    let asked = service.asked();
    assert_eq!(asked.len(), 6);
    assert!(asked.iter().all(|request| *request == asked[0]), "the same in head and body");
    assert!(asked[0].body == known("dcl.vquery"), "the query as it was sealed");
    for part in [
        "post /v1/maps/place/localize http/1.1\r\n",
        "content-type: application/x-protobuf\r\n",
        "authorization: bearer the-token\r\n",
        "accept: application/x-protobuf\r\n",
    ] {
        assert!(asked[0].head.contains(part), "{part} is not in {}", asked[0].head);
    }
    let reasons: Vec<String> = notices
        .lock()
        .expect("not poisoned")
        .iter()
        .map(|notice| match notice {
            Notice::Again { reason, .. } => reason.clone(),
            Notice::NotKept { .. } => panic!("no profile here"),
        })
        .collect();
    assert_eq!(reasons.len(), 5, "{reasons:?}");
    assert_eq!(reasons[0], "Title of queue-full (503): why");
    assert!(reasons[3].contains("504"), "{reasons:?}");

    // A second call with the same query sends the same bytes, too.
    let later = Service::saying(vec![protobuf(&known("without-fit.answer"))]);
    let query = query();
    assert_eq!(later.client().localize("place", &query).expect("an answer"), answer);
    assert!(later.asked()[0].body == asked[0].body);
}

#[test]
fn what_will_not_change_is_not_sent_again() {
    for (status, name) in [
        ("400 Bad", "malformed-query"),
        ("401 No", "unauthenticated"),
        ("404 No", "unknown-map"),
        ("409 No", "wrong-profile"),
        ("409 No", "empty-map"),
        ("413 No", "too-large"),
        ("422 No", "not-localized"),
        ("500 No", "broken"),
        ("307 Elsewhere", ""),
    ] {
        let elsewhere = Service::saying(vec![protobuf(&known("without-fit.answer"))]);
        let service = Service::saying(vec![
            problem(status, name, &[("location", &elsewhere.url), ("retry-after", "0")]),
            protobuf(&known("without-fit.answer")),
        ]);
        let error = service.client().localize("place", &query()).expect_err(name);
        assert_eq!(service.asked().len(), 1, "{status} {name}");
        assert!(elsewhere.asked().is_empty(), "a redirect is not followed");
        assert!(!error.may_send_again(), "{error}");
        let told = match (name, error) {
            ("wrong-profile", ClientError::WrongProfile(refusal))
            | ("not-localized", ClientError::NotLocalized(refusal)) => refusal,
            ("wrong-profile" | "not-localized", error) => panic!("{name}: {error:?}"),
            (_, ClientError::Refused(refusal)) => refusal,
            (_, error) => panic!("{name}: {error:?}"),
        };
        assert_eq!(told.name, name);
        assert!(status.starts_with(&told.status.to_string()));
    }
}

#[test]
fn a_busy_service_is_left_alone_for_as_long_as_it_asks() {
    // Asks for more than a device waits: told at once, with the time.
    let service = Service::saying(vec![problem("503 Busy", "queue-full", &[("retry-after", "3600")])]);
    let error = service.client().localize("place", &query()).expect_err("busy");
    assert!(error.may_send_again());
    let ClientError::Busy { refusal, retry_after } = error else { panic!("{error:?}") };
    assert_eq!((refusal.status, retry_after), (503, Some(Duration::from_secs(3600))));
    // Busy as often as it was asked.
    let busy = |after: &str| problem("429 Slow down", "rate-limited", &[("retry-after", after)]);
    let service = Service::saying(vec![busy(""), busy("7"), busy("0"), busy("20"), busy("")]);
    let (options, pauses) = recording();
    let client = Client::new(&service.url, None, options).expect("a client");
    let error = client.localize("place", &query()).expect_err("busy");
    assert!(matches!(error, ClientError::Busy { retry_after: None, .. }), "{error:?}");
    assert_eq!(service.asked().len(), 5);
    let pauses: Vec<f64> = pauses.lock().expect("not poisoned").iter().map(Duration::as_secs_f64).collect();
    assert_eq!(pauses, [0.5, 7.0, 0.0, 20.0], "its own pause where it is told none");
    assert!(!service.asked()[0].head.contains("authorization"), "without a token none is sent");
}

/// Where the service names no pause, each is longer than the one before, up to the longest.
#[test]
fn pauses_grow_up_to_the_longest() {
    let service = Service::saying(vec![Vec::new(); 8]);
    let (mut options, pauses) = recording();
    options.retry.retries = 7;
    options.retry.longest_pause = Duration::from_millis(2200);
    let client = Client::new(&service.url, None, options).expect("a client");
    client.localize("place", &query()).expect_err("it always breaks off");
    let pauses: Vec<u128> = pauses.lock().expect("not poisoned").iter().map(Duration::as_millis).collect();
    assert_eq!(pauses, [500, 1000, 1500, 2000, 2200, 2200, 2200]);
}

#[test]
fn a_service_that_is_not_there_is_a_matter_of_the_network() {
    // A port that is given to nobody.
    let nobody = "127.0.0.1:1";
    let mut options = quick();
    options.retry.retries = 1;
    let client = Client::new(&format!("http://{nobody}"), Some("the-token"), options).expect("a client");
    let error = client.localize("place", &query()).expect_err("nobody there");
    assert!(error.may_send_again() && matches!(error, ClientError::Network { .. }), "{error:?}");
    assert!(!format!("{client:?} {error:?} {error}").contains("the-token"));
}

#[test]
fn a_session_is_sent_as_it_was_sealed_and_again_as_it_was_sent() {
    let frame = |k: i32| SealedFrame {
        query: query(),
        cam_from_rig: CameraFromRig::from_quaternion([1.0, 0.0, 0.0, 0.0], [f64::from(k), 0.0, 0.0])
            .expect("a pose"),
        rotation_sd_deg: 0.1,
        translation_sd: 0.01,
    };
    let session = |frames: i32| RigMessage { frames: (0..frames).map(frame).collect() };
    let service = Service::saying(vec![
        problem("429 Slow down", "rate-limited", &[("retry-after", "0")]),
        protobuf(&known("without-fit.answer")),
    ]);
    let request = LocalizeRequest::default();
    let answer = service.client().localize_rig("place", &session(3), &request).expect("at last");
    assert_eq!(answer.inliers, 311);
    let asked = service.asked();
    assert!(asked.len() == 2 && asked[0] == asked[1], "the same in head and body");
    assert!(asked[0].head.contains("post /v1/maps/place/localize-rig http/1.1\r\n"), "{}", asked[0].head);
    assert!(asked[0].head.contains("content-type: application/octet-stream\r\n"), "{}", asked[0].head);
    let sent = RigMessage::decode(&asked[0].body).expect("a session");
    assert_eq!(sent.frames.len(), 3);
    assert!(sent.frames.iter().all(|frame| frame.query.encode() == query().encode()));
    // None and too many are not sent.
    let none = Service::saying(Vec::new());
    for frames in [0, 33] {
        let refused = none.client().localize_rig("place", &session(frames), &request).expect_err("refused");
        assert!(matches!(refused, ClientError::Frames { .. }) && !refused.may_send_again(), "{refused:?}");
        assert!(refused.to_string().contains("1 to 32"), "{refused}");
    }
    assert!(none.asked().is_empty());
}
