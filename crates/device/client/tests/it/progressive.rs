//! Progressive queries: the steps, their order, and when they end.

use super::common;

use common::{Service, known, problem, protobuf, reply};
use veiloc_client::{
    Answer, Client, ClientError, LocalizeRequest, Profile, ProgressiveAnswer, SealedQuery, StepOutcome,
    StopCriterion,
};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::Anchor;
use veiloc_protocol::{
    AnchoredRow, AngleBits, CanonicalCamera, Hints, LayoutTurn, QueryParts, Rows, SentContent,
};

fn profile(word: u8) -> Profile {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![word; 128]);
    Profile::vlad(words.and_then(Vocabulary::new).expect("one word"))
}

/// 1024 rows, each with a distinct descriptor. The first `blank` rows belong to one anchor.
fn query(blank: usize) -> SealedQuery {
    let bits = AngleBits::default();
    let row = |i: usize| {
        let anchor = if i < blank { Anchor::FIRST } else { Anchor::BOTH[i % 2] };
        AnchoredRow::new(bits, anchor, 0.003 * i as f64)
    };
    let descriptors = (0..1024 * 128).map(|i: usize| (i / 128 % 251) as u8).collect();
    let parts = QueryParts {
        camera: CanonicalCamera::from_codes(36, 20, 15).expect("512 px, 640 x 480"),
        scheme: "dcl".parse().expect("a scheme"),
        angle_bits: bits,
        rows: Rows::Dcl((0..1024).map(row).collect()),
        content: SentContent::Described {
            descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, descriptors).expect("whole rows"),
            image_global: None,
        },
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    SealedQuery::new(&profile(7), parts).expect("parts fit")
}

/// An answer with a pose of this standard deviation along each axis.
fn answer(trusted: bool, sd: f64) -> Vec<u8> {
    let mut answer = Answer::decode(&known("without-fit.answer")).expect("a known answer");
    let doubt = answer.doubts.first().cloned();
    answer.doubts = if trusted { Vec::new() } else { doubt.into_iter().collect() };
    let pose = answer.pose.as_mut().expect("a pose");
    pose.covariance = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sd * sd } else { 0.0 }));
    protobuf(&answer.encode())
}

fn send(
    client: &Client,
    query: &SealedQuery,
    criterion: StopCriterion,
) -> Result<ProgressiveAnswer, ClientError> {
    client.localize_progressive("place", query, &profile(7), criterion, &LocalizeRequest::default())
}

fn outcomes(found: &ProgressiveAnswer) -> Vec<(usize, StepOutcome)> {
    found.steps.iter().map(|step| (step.rows, step.outcome)).collect()
}

#[test]
fn progressive_query_stops_at_a_trusted_pose() {
    use StepOutcome::{Doubtful, NotLocalized, Trusted};
    let missing = || problem("422 No", "not-localized", &[]);
    let close = StopCriterion::accurate_to(0.01).expect("a deviation");
    for (replies, criterion, expected) in [
        (vec![answer(true, 0.02)], StopCriterion::TRUSTED, vec![(256, Trusted)]),
        (
            vec![missing(), answer(true, 0.02)],
            StopCriterion::TRUSTED,
            vec![(256, NotLocalized), (512, Trusted)],
        ),
        (
            vec![answer(false, 0.02), missing(), answer(true, 0.02)],
            StopCriterion::TRUSTED,
            vec![(256, Doubtful), (512, NotLocalized), (1024, Trusted)],
        ),
        (vec![answer(true, 0.02), answer(true, 0.009)], close, vec![(256, Trusted), (512, Trusted)]),
        // All rows are sent without reaching the accuracy.
        (vec![answer(true, 0.02); 3], close, vec![(256, Trusted), (512, Trusted), (1024, Trusted)]),
    ] {
        let service = Service::replying(replies);
        let found = send(&service.client(), &query(0), criterion).expect("an answer");
        assert_eq!(outcomes(&found), expected);
        let requests = service.requests();
        assert_eq!(requests.len(), expected.len());
        assert_eq!(found.bytes(), requests.iter().map(|request| request.body.len()).sum::<usize>());
        assert_eq!(found.rows(), expected.last().expect("steps").0);
        // L7: one sealed query, of which each step is a prefix.
        let whole = query(0);
        for (request, (rows, _)) in requests.iter().zip(&expected) {
            let sent = SealedQuery::decode(&request.body).expect("a query");
            assert_eq!(sent.len(), *rows);
            assert!(
                sent.descriptors().expect("rows").to_owned()
                    == whole.descriptors().expect("rows").rows(0..*rows).to_owned()
            );
            assert!(
                request.head
                    == requests[0]
                        .head
                        .replace(&content_length(&requests[0].body), &content_length(&request.body))
            );
        }
    }
}

fn content_length(body: &[u8]) -> String {
    format!("content-length: {}", body.len())
}

#[test]
fn errors_end_a_progressive_query() {
    // No pose with all rows.
    let service = Service::replying(vec![problem("422 No", "not-localized", &[]); 3]);
    let error = send(&service.client(), &query(0), StopCriterion::TRUSTED).expect_err("no pose");
    assert!(matches!(error, ClientError::NotLocalized(_)) && service.requests().len() == 3, "{error:?}");
    // An error response that more rows cannot change.
    let service = Service::replying(vec![problem("409 No", "wrong-profile", &[]), answer(true, 0.01)]);
    let error = send(&service.client(), &query(0), StopCriterion::TRUSTED).expect_err("refused");
    assert!(matches!(error, ClientError::WrongProfile(_)) && service.requests().len() == 1, "{error:?}");
    // Busy: the same bytes are sent again, also in a later call.
    let service =
        Service::replying(vec![reply("503 Busy", &[("retry-after", "0")], b""), answer(true, 0.01)]);
    send(&service.client(), &query(0), StopCriterion::TRUSTED).expect("at last");
    let requests = service.requests();
    assert!(requests.len() == 2 && requests[0] == requests[1]);
    let later = Service::replying(vec![answer(true, 0.01)]);
    send(&later.client(), &query(0), StopCriterion::TRUSTED).expect("an answer");
    assert!(later.requests()[0].body == requests[0].body);
}

#[test]
fn one_sided_steps_are_not_sent() {
    // The first 256 rows belong to one side: the first step is skipped.
    let service = Service::replying(vec![answer(true, 0.01)]);
    let found = send(&service.client(), &query(256), StopCriterion::TRUSTED).expect("an answer");
    assert_eq!(outcomes(&found), [(512, StepOutcome::Trusted)]);
    // All rows belong to one side, or the query was sealed for another map: nothing is sent.
    let service = Service::replying(Vec::new());
    let error = send(&service.client(), &query(1024), StopCriterion::TRUSTED).expect_err("unbalanced");
    assert!(matches!(error, ClientError::UnbalancedAnchors(_)), "{error:?}");
    let (client, request) = (service.client(), LocalizeRequest::default());
    let other =
        client.localize_progressive("place", &query(0), &profile(8), StopCriterion::TRUSTED, &request);
    assert!(matches!(other, Err(ClientError::ProfileMismatch(_))), "{other:?}");
    assert!(service.requests().is_empty());
}
