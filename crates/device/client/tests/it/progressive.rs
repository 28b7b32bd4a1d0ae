//! Progressive queries: what is sent, in which order, and when it ends.

use super::common;

use common::{Service, known, problem, protobuf, reply};
use veiloc_client::{
    Answer, Client, ClientError, Enough, LocalizeRequest, Profile, ProgressiveAnswer, SealedQuery,
    StepOutcome,
};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::Anchor;
use veiloc_protocol::{AnchoredRow, AngleBits, CanonicalCamera, Hints, LayoutTurn, QueryParts, Rows};

fn profile(word: u8) -> Profile {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![word; 128]);
    Profile::vlad(words.and_then(Vocabulary::new).expect("one word"))
}

/// 1024 rows, each with a descriptor of its own. Of the first `blank` ones all have one anchor.
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
        descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, descriptors).expect("whole rows"),
        image_global: None,
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    SealedQuery::new(&profile(7), parts).expect("parts fit")
}

/// An answer with a pose of this deviation along each axis.
fn answer(trusted: bool, sd: f64) -> Vec<u8> {
    let mut answer = Answer::decode(&known("without-fit.answer")).expect("a known answer");
    answer.trusted = trusted;
    let doubt = answer.doubts.first().cloned();
    answer.doubts = if trusted { Vec::new() } else { doubt.into_iter().collect() };
    let pose = answer.pose.as_mut().expect("a pose");
    pose.center_covariance = [[sd * sd, 0.0, 0.0], [0.0, sd * sd, 0.0], [0.0, 0.0, sd * sd]];
    protobuf(&answer.encode())
}

fn ask(client: &Client, query: &SealedQuery, enough: Enough) -> Result<ProgressiveAnswer, ClientError> {
    client.localize_progressive("place", query, &profile(7), enough, &LocalizeRequest::default())
}

fn outcomes(found: &ProgressiveAnswer) -> Vec<(usize, StepOutcome)> {
    found.steps.iter().map(|step| (step.rows, step.outcome)).collect()
}

#[test]
fn no_more_is_sent_than_a_trusted_pose_takes() {
    use StepOutcome::{Doubtful, NotLocalized, Trusted};
    let missing = || problem("422 No", "not-localized", &[]);
    let close = Enough::accurate_to(0.01).expect("a deviation");
    for (replies, enough, expected) in [
        (vec![answer(true, 0.02)], Enough::TRUSTED, vec![(256, Trusted)]),
        (vec![missing(), answer(true, 0.02)], Enough::TRUSTED, vec![(256, NotLocalized), (512, Trusted)]),
        (
            vec![answer(false, 0.02), missing(), answer(true, 0.02)],
            Enough::TRUSTED,
            vec![(256, Doubtful), (512, NotLocalized), (1024, Trusted)],
        ),
        (vec![answer(true, 0.02), answer(true, 0.009)], close, vec![(256, Trusted), (512, Trusted)]),
        // All rows are sent, and the pose is what it is.
        (vec![answer(true, 0.02); 3], close, vec![(256, Trusted), (512, Trusted), (1024, Trusted)]),
    ] {
        let service = Service::saying(replies);
        let found = ask(&service.client(), &query(0), enough).expect("an answer");
        assert_eq!(outcomes(&found), expected);
        let asked = service.asked();
        assert_eq!(asked.len(), expected.len());
        assert_eq!(found.bytes(), asked.iter().map(|request| request.body.len()).sum::<usize>());
        assert_eq!(found.rows(), expected.last().expect("steps").0);
        // L7: one seal, of which each step is the beginning.
        let whole = query(0);
        for (request, (rows, _)) in asked.iter().zip(&expected) {
            let sent = SealedQuery::decode(&request.body).expect("a query");
            assert_eq!(sent.len(), *rows);
            assert!(sent.descriptors().to_owned() == whole.descriptors().rows(0..*rows).to_owned());
            assert!(
                request.head
                    == asked[0].head.replace(&content_length(&asked[0].body), &content_length(&request.body))
            );
        }
    }
}

fn content_length(body: &[u8]) -> String {
    format!("content-length: {}", body.len())
}

#[test]
fn what_ends_a_query_ends_a_progressive_one() {
    // No pose with all rows.
    let service = Service::saying(vec![problem("422 No", "not-localized", &[]); 3]);
    let error = ask(&service.client(), &query(0), Enough::TRUSTED).expect_err("no pose");
    assert!(matches!(error, ClientError::NotLocalized(_)) && service.asked().len() == 3, "{error:?}");
    // A refusal that more rows do not change.
    let service = Service::saying(vec![problem("409 No", "wrong-profile", &[]), answer(true, 0.01)]);
    let error = ask(&service.client(), &query(0), Enough::TRUSTED).expect_err("refused");
    assert!(matches!(error, ClientError::WrongProfile(_)) && service.asked().len() == 1, "{error:?}");
    // Busy: the same bytes, and the same again when the app asks once more.
    let service = Service::saying(vec![reply("503 Busy", &[("retry-after", "0")], b""), answer(true, 0.01)]);
    ask(&service.client(), &query(0), Enough::TRUSTED).expect("at last");
    let asked = service.asked();
    assert!(asked.len() == 2 && asked[0] == asked[1]);
    let later = Service::saying(vec![answer(true, 0.01)]);
    ask(&later.client(), &query(0), Enough::TRUSTED).expect("an answer");
    assert!(later.asked()[0].body == asked[0].body);
}

#[test]
fn what_cannot_fix_a_pose_is_not_sent() {
    // The first 256 rows are of one side: the first step is left out.
    let service = Service::saying(vec![answer(true, 0.01)]);
    let found = ask(&service.client(), &query(256), Enough::TRUSTED).expect("an answer");
    assert_eq!(outcomes(&found), [(512, StepOutcome::Trusted)]);
    // All of them are, or the query is of another map: nothing is sent.
    let service = Service::saying(Vec::new());
    let error = ask(&service.client(), &query(1024), Enough::TRUSTED).expect_err("lopsided");
    assert!(matches!(error, ClientError::Lopsided(_)), "{error:?}");
    let (client, request) = (service.client(), LocalizeRequest::default());
    let other = client.localize_progressive("place", &query(0), &profile(8), Enough::TRUSTED, &request);
    assert!(matches!(other, Err(ClientError::NotOfProfile(_))), "{other:?}");
    assert!(service.asked().is_empty());
}
