//! L7: a retry sends the same bytes, and only when it can help.

use super::common;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Service, known, problem, protobuf, query, quick, recording, reply};
use veiloc_client::{CameraFromRig, Client, ClientError, LocalizeRequest, Notice, RigMessage, SealedFrame};
use veiloc_protocol::{SealedIn, SessionTag};

#[test]
fn retry_sends_the_same_bytes() {
    let service = Service::replying(vec![
        problem("503 Busy", "queue-full", &[("retry-after", "0")]),
        Vec::new(),
        problem("429 Slow down", "rate-limited", &[("retry-after", "0")]),
        reply("504 Late", &[], b""),
        // The connection closes in the middle of the answer.
        protobuf(&known("without-fit.answer"))[..3000].to_vec(),
        protobuf(&known("without-fit.answer")),
    ]);
    let notices = Arc::new(Mutex::new(Vec::new()));
    let recorded = notices.clone();
    let mut options = quick();
    options.retry.retries = 5;
    options.notice = Some(Arc::new(move |notice: &Notice| {
        recorded.lock().expect("not poisoned").push(notice.clone());
    }));
    let client = Client::new(&service.url, Some("the-token"), options).expect("a client");
    let answer = client.localize("place", &query()).expect("at last");
    assert_eq!(answer.inliers, 311);
    let requests = service.requests();
    assert_eq!(requests.len(), 6);
    assert!(requests.iter().all(|request| *request == requests[0]), "equal head and body");
    assert!(requests[0].body == known("dcl.vquery"), "the query as it was sealed");
    for part in [
        "post /v1/maps/place/localize http/1.1\r\n",
        "content-type: application/x-protobuf\r\n",
        "authorization: bearer the-token\r\n",
        "accept: application/x-protobuf\r\n",
    ] {
        assert!(requests[0].head.contains(part), "{part} is not in {}", requests[0].head);
    }
    let reasons: Vec<String> = notices
        .lock()
        .expect("not poisoned")
        .iter()
        .map(|notice| match notice {
            Notice::Again { reason, .. } => reason.clone(),
            Notice::CacheWriteFailed { .. } | Notice::Changed { .. } => panic!("no profile here"),
        })
        .collect();
    assert_eq!(reasons.len(), 5, "{reasons:?}");
    assert_eq!(reasons[0], "Title of queue-full (503): why");
    assert!(reasons[3].contains("504"), "{reasons:?}");

    // A later call with the same query also sends the same bytes.
    let later = Service::replying(vec![protobuf(&known("without-fit.answer"))]);
    let query = query();
    assert_eq!(later.client().localize("place", &query).expect("an answer"), answer);
    assert!(later.requests()[0].body == requests[0].body);
}

#[test]
fn permanent_errors_are_not_retried() {
    for (status, name) in [
        ("400 Bad", "malformed-query"),
        ("401 No", "unauthenticated"),
        ("404 No", "unknown-map"),
        ("409 No", "wrong-profile"),
        ("409 No", "empty-map"),
        ("413 No", "too-large"),
        ("422 No", "not-localized"),
        ("500 No", "broken"),
        ("307 Redirect", ""),
    ] {
        let redirect_target = Service::replying(vec![protobuf(&known("without-fit.answer"))]);
        let service = Service::replying(vec![
            problem(status, name, &[("location", &redirect_target.url), ("retry-after", "0")]),
            protobuf(&known("without-fit.answer")),
        ]);
        let error = service.client().localize("place", &query()).expect_err(name);
        assert_eq!(service.requests().len(), 1, "{status} {name}");
        assert!(redirect_target.requests().is_empty(), "a redirect is not followed");
        assert!(!error.is_retryable(), "{error}");
        let refusal = match (name, error) {
            ("wrong-profile", ClientError::WrongProfile(refusal))
            | ("not-localized", ClientError::NotLocalized(refusal)) => refusal,
            ("wrong-profile" | "not-localized", error) => panic!("{name}: {error:?}"),
            (_, ClientError::Refused(refusal)) => refusal,
            (_, error) => panic!("{name}: {error:?}"),
        };
        assert_eq!(refusal.name, name);
        assert!(status.starts_with(&refusal.status.to_string()));
    }
}

#[test]
fn retry_after_is_respected() {
    // The service asks for a longer pause than the limit: the call fails at once and reports the pause.
    let service = Service::replying(vec![problem("503 Busy", "queue-full", &[("retry-after", "3600")])]);
    let error = service.client().localize("place", &query()).expect_err("busy");
    assert!(error.is_retryable());
    let ClientError::Busy { refusal, retry_after } = error else { panic!("{error:?}") };
    assert_eq!((refusal.status, retry_after), (503, Some(Duration::from_secs(3600))));
    // Busy in every attempt.
    let busy = |after: &str| problem("429 Slow down", "rate-limited", &[("retry-after", after)]);
    let service = Service::replying(vec![busy(""), busy("7"), busy("0"), busy("20"), busy("")]);
    let (options, pauses) = recording();
    let client = Client::new(&service.url, None, options).expect("a client");
    let error = client.localize("place", &query()).expect_err("busy");
    assert!(matches!(error, ClientError::Busy { retry_after: None, .. }), "{error:?}");
    assert_eq!(service.requests().len(), 5);
    let pauses: Vec<f64> = pauses.lock().expect("not poisoned").iter().map(Duration::as_secs_f64).collect();
    assert_eq!(pauses, [0.5, 7.0, 0.0, 20.0], "the client's own pause where the service gives none");
    assert!(!service.requests()[0].head.contains("authorization"), "no token is sent without one");
}

/// Without a pause from the service, each pause is longer than the previous one, up to the limit.
#[test]
fn pauses_double_up_to_the_limit() {
    let service = Service::replying(vec![Vec::new(); 8]);
    let (mut options, pauses) = recording();
    options.retry.retries = 7;
    options.retry.longest_pause = Duration::from_millis(2200);
    let client = Client::new(&service.url, None, options).expect("a client");
    client.localize("place", &query()).expect_err("it always breaks off");
    let pauses: Vec<u128> = pauses.lock().expect("not poisoned").iter().map(Duration::as_millis).collect();
    assert_eq!(pauses, [500, 1000, 1500, 2000, 2200, 2200, 2200]);
}

#[test]
fn unreachable_service_is_a_network_error() {
    // A port without a listener.
    let unused_port = "127.0.0.1:1";
    let mut options = quick();
    options.retry.retries = 1;
    let client = Client::new(&format!("http://{unused_port}"), Some("the-token"), options).expect("a client");
    let error = client.localize("place", &query()).expect_err("no listener");
    assert!(error.is_retryable() && matches!(error, ClientError::Network { .. }), "{error:?}");
    assert!(!format!("{client:?} {error:?} {error}").contains("the-token"));
}

#[test]
fn session_retry_sends_the_same_bytes() {
    let frame = |k: i32| SealedFrame {
        query: query(),
        cam_from_rig: CameraFromRig::from_quaternion([1.0, 0.0, 0.0, 0.0], [f64::from(k), 0.0, 0.0])
            .expect("a pose"),
        rotation_sd_deg: 0.1,
        translation_sd: 0.01,
    };
    let session = |frames: i32| RigMessage { frames: (0..frames).map(frame).collect() };
    let service = Service::replying(vec![
        problem("429 Slow down", "rate-limited", &[("retry-after", "0")]),
        protobuf(&known("without-fit.answer")),
    ]);
    let request = LocalizeRequest::default();
    let answer = service.client().localize_rig("place", &session(3), &request).expect("at last");
    assert_eq!(answer.inliers, 311);
    let requests = service.requests();
    assert!(requests.len() == 2 && requests[0] == requests[1], "equal head and body");
    assert!(
        requests[0].head.contains("post /v1/maps/place/localize-rig http/1.1\r\n"),
        "{}",
        requests[0].head
    );
    assert!(requests[0].head.contains("content-type: application/octet-stream\r\n"), "{}", requests[0].head);
    let sent = RigMessage::decode(&requests[0].body).expect("a session");
    assert_eq!(sent.frames.len(), 3);
    assert!(sent.frames.iter().all(|frame| frame.query.encode() == query().encode()));
    // Sessions with no frames or too many are not sent.
    let none = Service::replying(Vec::new());
    for frames in [0, 33] {
        let refused = none.client().localize_rig("place", &session(frames), &request).expect_err("refused");
        assert!(matches!(refused, ClientError::Frames { .. }) && !refused.is_retryable(), "{refused:?}");
        assert!(refused.to_string().contains("1 to 32"), "{refused}");
    }
    assert!(none.requests().is_empty());
}

/// Lines of a keypoint under two anchors cross in it: such frames are not sent (rule L10).
#[test]
fn frames_of_several_sessions_are_not_sent() {
    // Half a turn about the viewing direction: each frame has its anchors in its image.
    let frame = |query, turned: f64| SealedFrame {
        query,
        cam_from_rig: CameraFromRig::from_quaternion([1.0 - turned, 0.0, 0.0, turned], [0.1, 0.0, 0.0])
            .expect("a pose"),
        rotation_sd_deg: 0.5,
        translation_sd: 0.01,
    };
    let rig = |known: [SealedIn; 2]| {
        let [a, b] = known.map(|sealed_in| query().with_sealed_in(sealed_in));
        RigMessage { frames: vec![frame(a, 0.0), frame(b, 1.0)] }
    };
    let [own, other] = [1, 2].map(|tag| SealedIn::Session(SessionTag([tag; 8])));
    let request = LocalizeRequest::default();
    let none = Service::replying(Vec::new());
    for known in [[SealedIn::Unknown; 2], [SealedIn::Alone; 2], [own, other], [own, SealedIn::Alone]] {
        let refused = none.client().localize_rig("place", &rig(known), &request).expect_err("refused");
        assert!(matches!(refused, ClientError::SeparateAnchors(_)) && !refused.is_retryable(), "{refused:?}");
        assert!(refused.to_string().contains("seal all images of a rig in one session"), "{refused}");
    }
    assert!(none.requests().is_empty());
    let service = Service::replying(vec![protobuf(&known("without-fit.answer"))]);
    service.client().localize_rig("place", &rig([own; 2]), &request).expect("one session");
    let sent = &service.requests()[0].body;
    assert_eq!(*sent, rig([SealedIn::Unknown; 2]).encode(), "nothing of the session");
}
