//! The answer message: as the schema defines it, pinned, and strict for arbitrary bytes.

use super::common;

use common::{answer, answer_with_fit, known_replies};
use proptest::prelude::*;
use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use veiloc_protocol::{Answer, AnswerFit, AnswerPose, AnswerState, QueryError};

#[test]
fn answers_match_the_schema() {
    let proto = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../proto");
    let set = protox::compile(["veiloc/v1/answer.proto"], [proto]).expect("the schema compiles");
    let pool = DescriptorPool::from_file_descriptor_set(set).expect("complete");
    let descriptor = pool.get_message_by_name("veiloc.v1.Answer").expect("in the schema");
    for (doubts, ours) in (0..6).flat_map(|n| [answer(3, n), answer_with_fit(3, n)].map(|answer| (n, answer)))
    {
        let bytes = ours.encode();
        let message = DynamicMessage::decode(descriptor.clone(), bytes.as_slice()).expect("such a message");
        assert_eq!(message.unknown_fields().count(), 0, "fields that the schema lacks");
        for field in descriptor.fields() {
            let expected = match field.name() {
                "doubts" => doubts > 0,
                "noise_px" | "focal_scale" | "principal_shift_px" => ours.fit.is_some(),
                "metres_per_unit" | "down" => ours.map.down.is_some(),
                _ => true,
            };
            assert_eq!(message.has_field(&field), expected, "{}", field.full_name());
        }
        assert_eq!(message.encode_to_vec(), bytes);
        let value = |name: &str| message.get_field_by_name(name).expect("in the schema").into_owned();
        let list = |values: &[f64]| Value::List(values.iter().map(|v| Value::F64(*v)).collect());
        let pose = ours.pose.expect("a pose");
        assert_eq!(value("version"), Value::U32(1));
        assert_eq!(value("rotation"), list(&pose.rotation));
        assert_eq!(value("covariance"), list(&pose.covariance.concat()));
        assert_eq!(value("milliseconds"), list(&[0.25, 0.5, 12.0, 3.75]));
        assert_eq!(value("gravity"), Value::U32(if ours.fit.is_some() { 1 } else { 2 }));
        assert_eq!((value("inliers"), value("matches")), (Value::U32(311), Value::U32(912)));
        let count = value("doubts").as_list().expect("a list").len();
        assert_eq!(count, doubts);
        if let Some(fit) = ours.fit {
            assert_eq!(
                (value("noise_px"), value("focal_scale")),
                (Value::F64(fit.noise_px), Value::F64(fit.focal_scale))
            );
            assert_eq!(value("principal_shift_px"), list(&fit.principal_shift_px));
            assert_eq!((value("metres_per_unit"), value("down")), (Value::F64(1.0), list(&[0.0, -1.0, 0.0])));
        }
        assert_eq!(Answer::decode(&bytes).expect("own bytes"), ours);
    }
}

/// L12: the length of an answer reveals neither the number of doubts nor the length of their texts.
#[test]
fn answers_have_one_length() {
    for doubts in 0..12 {
        for words in [0, 1, 100, 200] {
            let mut answer = answer(7, doubts);
            answer.doubts.iter_mut().for_each(|doubt| doubt.text = "w".repeat(words));
            // The same holds for an answer that reports its fit, and for one whose pose is withheld.
            let Answer { fit, map, .. } = answer_with_fit(7, 0);
            let full = Answer { fit, map, ..answer.clone() };
            for answer in [answer, full.clone(), full.trusted_only()] {
                assert_eq!(answer.encode().len(), Answer::PADDED_BYTES, "{doubts}, {words}");
            }
        }
    }
    // Longer answers, which our server does not make, take the next multiple; tested around each step too.
    for words in 0..12_000 {
        let mut answer = answer(7, 1);
        answer.doubts[0].text = "w".repeat(words);
        let bytes = answer.encode();
        assert_eq!(bytes.len() % Answer::PADDED_BYTES, 0, "{words}");
        assert_eq!(Answer::decode(&bytes).as_ref(), Ok(&answer), "{words}");
    }
}

/// Pinned byte for byte.
#[test]
fn known_answers_round_trip() {
    for (file, expected) in known_replies() {
        let path = format!("{}/tests/data/{file}.answer", env!("CARGO_MANIFEST_DIR"));
        let bytes = std::fs::read(path).expect("the known answer");
        let read = Answer::decode(&bytes).expect("an answer");
        assert_eq!(read, expected);
        assert!(read.encode() == bytes, "{file} is now encoded differently");
    }
    // The document that every binding gives: `scripts/phones/run.py` and `bindings/web/check.mjs` compare theirs.
    let expected = include_str!("../data/doubtful.json");
    assert_eq!(expected, answer_with_fit(1, 2).to_json());
}

/// Only doubtful poses can be withheld.
#[test]
fn only_doubtful_poses_can_be_withheld() {
    let trusted = answer_with_fit(1, 0);
    assert_eq!(trusted.clone().trusted_only(), trusted);
    let withheld = answer_with_fit(1, 2).trusted_only();
    assert_eq!((withheld.pose, withheld.doubts.len(), withheld.state()), (None, 2, AnswerState::Doubtful));
    assert_eq!(Answer::decode(&withheld.encode()), Ok(withheld.clone()));
    // A trusted answer without a pose, or with an incomplete pose, is invalid.
    let lying = Answer { doubts: Vec::new(), ..withheld };
    let refused = Answer::decode(&lying.encode());
    assert!(matches!(refused, Err(QueryError::Length { field: "rotation", .. })), "{refused:?}");
    let whole = answer_with_fit(1, 2).encode();
    let rotation = 2 + 4 * 8; // key, length, four numbers, after the version
    let part = [&whole[..5], &whole[5 + rotation..]].concat();
    assert!(matches!(Answer::decode(&part), Err(QueryError::NotCanonical { .. })));
    let wrong = |noise_px, focal_scale| {
        let fit = Some(AnswerFit { noise_px, focal_scale, principal_shift_px: [0.0; 2] });
        Answer::decode(&Answer { fit, ..answer(1, 0) }.encode())
    };
    for (noise, scale, field) in [
        (f64::NAN, 1.0, "noise_px"),
        (-1.0, 1.0, "noise_px"),
        (1.0, 0.0, "focal_scale"),
        (1.0, f64::INFINITY, "focal_scale"),
    ] {
        let refused = wrong(noise, scale);
        assert!(matches!(refused, Err(QueryError::Mismatch { what, .. }) if what == field), "{refused:?}");
    }
    assert_eq!(Answer::decode(&answer(1, 0).encode()), Ok(answer(1, 0)));
}

#[test]
fn position_sd_is_the_largest_standard_deviation() {
    let mut pose = answer(1, 0).pose.expect("a pose");
    // Rotated about the third axis by 30 degrees: variances 4, 1 and 0.25 along the rotated axes.
    let (s, c) = (0.5, 0.75_f64.sqrt());
    let block =
        [[4.0 * c * c + s * s, 3.0 * s * c, 0.0], [3.0 * s * c, 4.0 * s * s + c * c, 0.0], [0.0, 0.0, 0.25]];
    for (row, of_translation) in pose.covariance[3..].iter_mut().zip(block) {
        row[3..].copy_from_slice(&of_translation);
    }
    assert!((pose.position_sd() - 2.0).abs() < 1e-12, "{}", pose.position_sd());
    pose.covariance[5][5] = f64::INFINITY;
    assert!(pose.position_sd().is_infinite());
}

/// The centre follows from the pose, and its covariance has the same least certain direction.
#[test]
fn center_follows_from_the_pose() {
    let mut pose = answer(1, 0).pose.expect("a pose");
    pose.covariance = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) * 0.25));
    // A quarter turn about z takes x to y and y to -x.
    pose.rotation = [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()];
    let ([x, y, z], center) = (pose.translation, pose.center());
    let off = center.iter().zip([-y, x, -z]).map(|(c, expected)| (c - expected).abs()).fold(0.0, f64::max);
    assert!(off < 1e-9, "{center:?} and {:?}", pose.translation);
    assert!(pose.position_sd() > 0.49 && pose.center_covariance()[0][0] > 0.24);
    pose.rotation = [0.0; 4];
    assert!(pose.cam_from_world().is_none() && pose.center().iter().all(|c| c.is_nan()));
}

#[test]
fn error_names_the_invalid_field() {
    type Change = fn(&mut Answer);
    let refused = |change: Change| {
        let mut wrong = answer(1, 1);
        change(&mut wrong);
        Answer::decode(&wrong.encode()).expect_err("refused")
    };
    fn pose(answer: &mut Answer) -> &mut AnswerPose {
        answer.pose.as_mut().expect("a pose")
    }
    let cases: [(Change, &str); 9] = [
        (|a| pose(a).rotation[0] = 0.6, "rotation"),
        (|a| pose(a).rotation[2] = f64::NAN, "rotation"),
        (|a| pose(a).translation[1] = f64::INFINITY, "translation"),
        (|a| pose(a).covariance[2][3] = f64::NAN, "covariance"),
        (|a| a.margin = f64::NAN, "margin"),
        (|a| a.times.match_ms = -1.0, "milliseconds"),
        (|a| a.map.metres_per_unit = Some(0.0), "metres_per_unit"),
        (|a| a.map.down = Some([0.0, 0.0, 2.0]), "down"),
        (|a| a.map.down = Some([0.0, f64::NAN, 1.0]), "down"),
    ];
    for (change, field) in cases {
        let error = refused(change);
        assert!(matches!(error, QueryError::Mismatch { what, .. } if what == field), "{field}: {error}");
    }
    let (without_fit, bytes) = (answer(1, 1).encode(), answer_with_fit(1, 1).encode());
    let mut telling = without_fit.clone();
    telling[Answer::PADDED_BYTES - 1] = 1;
    Answer::decode(&telling).expect_err("padding of other bytes than zeros");
    for bytes in [without_fit, bytes] {
        assert!(Answer::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err(), "trailing field");
        for cut in 0..bytes.len() {
            assert!(Answer::decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }
}

#[test]
fn version_error_states_the_remedy() {
    for unknown in [0, 2, 3] {
        let bytes = [&[0x0D, unknown, 0, 0, 0], &answer(1, 1).encode()[5..]].concat();
        let refused = Answer::decode(&bytes).expect_err("refused");
        let found = u32::from(unknown);
        assert!(
            matches!(refused, QueryError::Version { what: "answer", found: f, supported: 1, .. } if f == found)
        );
        let text = refused.to_string();
        assert!(text.contains(&format!("version {found}")) && text.contains("update the app"), "{text}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_rejected_or_round_trip(bytes in prop::collection::vec(any::<u8>(), 0..700)) {
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert_eq!(answer.encode(), bytes);
        }
    }

    #[test]
    fn damaged_answers_are_rejected_or_round_trip(
        doubts in 0..4_usize,
        withheld: bool,
        with_fit: bool,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut answer = if with_fit { answer_with_fit(9, doubts) } else { answer(9, doubts) };
        if withheld {
            answer = answer.trusted_only();
        }
        let mut bytes = answer.encode();
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert_eq!(answer.encode(), bytes);
        }
    }
}
