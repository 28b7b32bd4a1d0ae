//! Valid, damaged and random frames.

use proptest::prelude::*;
use veiloc_protocol::{AnswerPose, AnswerTimes, GravityUse, MapCoordinates};

use super::*;
use crate::frame_version::VERSION;

const NAME: RequestIdBytes = [7; 16];

fn object() -> ObjectId {
    ObjectId::of(b"region")
}

fn request(task: Task) -> Request {
    let lane = Some(Lane::from_bytes([9; 32]));
    let (within, span) = (Duration::from_millis(29_500), SpanId::from_number(0x0123_4567_89ab_cdef));
    Request { version: VERSION, name: NAME, object: object(), lane, rows: 1024, within, span, task }
}

fn answer() -> Answer {
    Answer {
        pose: Some(AnswerPose {
            rotation: [0.5, -0.5, 0.5, 0.5],
            translation: [0.1 + 0.2, -3.0, 1e-17],
            covariance: [[1e-9; 6]; 6],
        }),
        doubts: Vec::new(),
        log_evidence: 123.456_789_012_345,
        margin: f64::INFINITY,
        fit: None,
        gravity: GravityUse::Used,
        map: MapCoordinates { metres_per_unit: Some(1.0), down: None },
        inliers: 100,
        matches: 200,
        hypotheses: 300,
        times: AnswerTimes { queue_ms: 0.25, retrieve_ms: 1.5, match_ms: 20.0, pose_ms: 7.0 },
    }
}

fn all_outcomes() -> Vec<ReplyOutcome> {
    let retry_after = NonZeroU64::new(7).expect("not zero");
    let mut all = vec![
        ReplyOutcome::Here { unknown: Vec::new() },
        ReplyOutcome::Here { unknown: vec![0, 63] },
        ReplyOutcome::Regions(vec![Candidate { region: 4, held: 10 }, Candidate { region: 0, held: 3 }]),
        ReplyOutcome::Pose(Box::new(answer())),
    ];
    let why = [
        LocalizeFailure::WrongProfile,
        LocalizeFailure::EmptyMap,
        LocalizeFailure::NoPose(NoPose::Unsupported),
        LocalizeFailure::NoPose(NoPose::OneSided),
        LocalizeFailure::NoPose(NoPose::TooFew),
        LocalizeFailure::Stopped,
        LocalizeFailure::Busy { retry_after },
        LocalizeFailure::Unreached { retry_after },
        LocalizeFailure::TimedOut,
        LocalizeFailure::Broken,
    ];
    let busy = RejectReason::Busy { retry_after };
    let reject_reasons = [
        busy,
        RejectReason::InProgress,
        RejectReason::Leaving,
        RejectReason::NotHeld,
        RejectReason::Undecodable,
        RejectReason::Broken,
    ];
    all.extend(why.map(ReplyOutcome::Failed));
    all.extend(reject_reasons.map(ReplyOutcome::Rejected));
    all
}

fn reply(outcome: ReplyOutcome) -> Reply {
    let (worked, waited) = (Duration::from_micros(31_415), Duration::from_micros(9));
    Reply { version: VERSION, name: NAME, outcome, worked, waited, load: Load { jobs: 3, free: 29 } }
}

#[test]
fn requests_round_trip() {
    let near = "1.5,-2,3,0.25".parse().expect("a position");
    let body = Bytes::from_static(b"sealed bytes, as they came");
    for task in [
        Task::Ping { owed: Vec::new() },
        Task::Ping { owed: vec![(NAME, object()); MAX_PINGED] },
        Task::Search { globals: vec![Bytes::from_static(&[1, 255]), Bytes::from_static(&[0, 7])] },
        Task::Pose { kind: BodyKind::Query, body: body.clone(), near: None },
        Task::Pose { kind: BodyKind::Rig, body: body.clone(), near: Some(near) },
    ] {
        let request = request(task);
        let bytes = request.encode();
        assert!(bytes.len() <= FRAME_BYTES + body.len() || matches!(request.task, Task::Ping { .. }));
        assert_eq!(Request { lane: None, ..request.clone() }.encode().len(), bytes.len() - 34);
        assert_eq!(Request { span: None, ..request.clone() }.encode().len(), bytes.len() - 9);
        assert!(Request::decode(bytes).expect("read") == request);
    }
}

#[test]
fn replies_round_trip_with_equal_length() {
    for outcome in all_outcomes() {
        let reply = reply(outcome);
        let bytes = reply.encode();
        if matches!(
            reply.outcome,
            ReplyOutcome::Pose(_) | ReplyOutcome::Failed(_) | ReplyOutcome::Rejected(_)
        ) {
            assert_eq!(bytes.len(), REPLY_BYTES, "{:?}", reply.outcome);
        }
        assert_eq!(Reply::decode(bytes.clone(), &NAME).expect("read"), reply);
        assert!(matches!(Reply::decode(bytes, &[8; 16]), Err(ClusterError::OtherRequest)));
    }
}

#[test]
fn invalid_frames_name_the_field() {
    let request = |change: &dyn Fn(&mut RequestFrame)| {
        let body = Bytes::from_static(b"body");
        let good = request(Task::Pose { kind: BodyKind::Query, body, near: None }).encode();
        let mut frame = RequestFrame::decode(good).expect("a frame");
        change(&mut frame);
        Request::decode(frame.encode_to_vec().into()).expect_err("refused").to_string()
    };
    let field = |field| ClusterError::FrameField { field }.to_string();
    assert_eq!(request(&|f| f.version = 1), ClusterError::FrameVersion { found: 1 }.to_string());
    assert_eq!(request(&|f| f.name = Bytes::from_static(b"short")), field("name"));
    assert_eq!(request(&|f| f.object = Bytes::new()), field("object"));
    assert_eq!(request(&|f| f.wanted = 9), field("wanted"));
    assert_eq!(request(&|f| f.body.clear()), field("body"));
    assert_eq!(request(&|f| f.wanted = PING), field("body"));
    assert_eq!(request(&|f| f.lane = Bytes::from_static(b"short")), field("lane"));
    assert_eq!(request(&|f| f.near = vec![1.0]), field("near"));
    assert_eq!(request(&|f| f.near = vec![1.0, 2.0, 3.0, 0.0]), field("near"));

    let reply = |change: &dyn Fn(&mut ReplyFrame)| {
        let good = reply(ReplyOutcome::Pose(Box::new(answer()))).encode();
        let mut frame = ReplyFrame::decode(good).expect("a frame");
        change(&mut frame);
        Reply::decode(frame.encode_to_vec().into(), &NAME).expect_err("refused").to_string()
    };
    assert_eq!(reply(&|f| f.version = 0), ClusterError::FrameVersion { found: 0 }.to_string());
    assert_eq!(reply(&|f| f.name = Bytes::new()), field("name"));
    assert_eq!(reply(&|f| f.outcome = 99), field("outcome"));
    assert_eq!(reply(&|f| f.answer = f.answer.slice(1..)), field("answer"));
    assert_eq!(reply(&|f| f.outcome = 22), field("retry_after"));
    assert_eq!(reply(&|f| (f.outcome, f.retry_after) = (32, 61)), field("retry_after"));
    assert_eq!(reply(&|f| (f.outcome, f.regions) = (REGIONS, vec![1])), field("regions"));
    let many = vec![0; MAX_REGIONS + 1];
    assert_eq!(
        reply(&|f| (f.outcome, f.regions, f.held) = (REGIONS, many.clone(), many.clone())),
        field("regions")
    );
    assert_eq!(reply(&|f| (f.outcome, f.regions) = (HERE, vec![0; MAX_PINGED + 1])), field("regions"));
}

#[test]
fn debug_hides_the_query() {
    let body = Bytes::from_static(b"SECRET");
    let near = Some("4711,0,0,1".parse().expect("a position"));
    let shown = format!("{:?}", request(Task::Pose { kind: BodyKind::Query, body, near }));
    assert!(!shown.contains("SECRET") && !shown.contains("4711") && !shown.contains("83, 69"), "{shown}");
}

proptest! {
    /// No bytes make a decoder panic, and what was decoded is encoded with the same meaning.
    #[test]
    fn arbitrary_bytes_are_decoded_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200), cut in 0_usize..6000, flip in 0_usize..6000) {
        drop(Request::decode(bytes.clone().into()));
        drop(Reply::decode(bytes.into(), &NAME));
        for outcome in all_outcomes() {
            let mut bytes = reply(outcome).encode().to_vec();
            bytes.truncate(cut.max(1));
            let position = flip % bytes.len();
            bytes[position] ^= 1 << (flip % 8);
            if let Ok(read) = Reply::decode(bytes.into(), &NAME) {
                prop_assert_eq!(Reply::decode(read.encode(), &NAME).expect("read again"), read);
            }
        }
    }
}
