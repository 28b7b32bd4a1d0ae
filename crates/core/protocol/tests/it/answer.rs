//! The answer message: what the schema says, pinned, and strict towards any bytes.

use super::common;

use common::{answer, answer_in, known_replies};
use proptest::prelude::*;
use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use veiloc_protocol::{Answer, AnswerFit, AnswerPose, AnswerState, AnswerVersion, QueryError};

#[test]
fn answers_are_what_the_schema_says() {
    let proto = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../proto");
    let set = protox::compile(["veiloc/v1/answer.proto"], [proto]).expect("the schema compiles");
    let pool = DescriptorPool::from_file_descriptor_set(set).expect("complete");
    let descriptor = pool.get_message_by_name("veiloc.v1.Answer").expect("in the schema");
    for (doubts, version) in (0..6).flat_map(|n| AnswerVersion::ALL.map(|version| (n, version))) {
        let ours = answer_in(version, 3, doubts);
        let bytes = written(&ours, version);
        let message = DynamicMessage::decode(descriptor.clone(), bytes.as_slice()).expect("such a message");
        assert_eq!(message.unknown_fields().count(), 0, "fields that the schema lacks");
        for field in descriptor.fields() {
            let expected = match field.name() {
                "doubts" => doubts > 0,
                "padding" => version != AnswerVersion::Plain,
                "noise_px" | "focal_scale" => version == AnswerVersion::Full,
                _ => true,
            };
            assert_eq!(message.has_field(&field), expected, "{}", field.full_name());
        }
        assert_eq!(message.encode_to_vec(), bytes);
        let value = |name: &str| message.get_field_by_name(name).expect("in the schema").into_owned();
        let list = |values: &[f64]| Value::List(values.iter().map(|v| Value::F64(*v)).collect());
        let pose = ours.pose.expect("a pose");
        assert_eq!(value("version"), Value::U32(version.number()));
        assert_eq!(value("rotation"), list(&pose.rotation));
        assert_eq!(value("covariance"), list(&pose.covariance.concat()));
        assert_eq!(value("milliseconds"), list(&[0.25, 0.5, 12.0, 3.75]));
        assert_eq!(value("trusted"), Value::U32(u32::from(doubts == 0)));
        assert_eq!((value("inliers"), value("matches")), (Value::U32(311), Value::U32(912)));
        let told = value("doubts").as_list().expect("a list").len();
        assert_eq!(told, doubts);
        if let Some(fit) = ours.fit {
            assert_eq!(
                (value("noise_px"), value("focal_scale")),
                (Value::F64(fit.noise_px), Value::F64(fit.focal_scale))
            );
        }
        assert_eq!(Answer::decode(&bytes).expect("own bytes"), ours);
    }
}

fn written(answer: &Answer, version: AnswerVersion) -> Vec<u8> {
    answer.encode(version).expect("this version can say it")
}

/// L12: the length of a padded answer does not tell how many doubts are in it, nor how long their words are.
#[test]
fn padded_answers_have_one_length() {
    for doubts in 0..12 {
        for words in [0, 1, 100, 200] {
            let mut answer = answer(7, doubts);
            answer.doubts.iter_mut().for_each(|doubt| doubt.text = "w".repeat(words));
            for version in [AnswerVersion::Padded, AnswerVersion::Full] {
                assert_eq!(written(&answer, version).len(), Answer::PADDED_BYTES, "{doubts}, {words}");
            }
            // So has one that knows how well it fits, and one whose pose is withheld.
            let full = Answer { fit: answer_in(AnswerVersion::Full, 7, 0).fit, ..answer };
            for answer in [full.clone(), full.trusted_only()] {
                let bytes = written(&answer, AnswerVersion::Full);
                assert_eq!(bytes.len(), Answer::PADDED_BYTES, "{doubts}, {words}");
            }
        }
    }
    // Longer ones, which our server does not make, take the next whole number; around each step too.
    for words in 0..12_000 {
        let mut answer = answer(7, 1);
        answer.doubts[0].text = "w".repeat(words);
        let bytes = written(&answer, AnswerVersion::Padded);
        assert_eq!(bytes.len() % Answer::PADDED_BYTES, 0, "{words}");
        assert_eq!(Answer::decode(&bytes).as_ref(), Ok(&answer), "{words}");
    }
}

/// Each version, pinned byte for byte: every later program must read it and write it back unchanged.
#[test]
fn every_version_is_read_and_written_for_ever() {
    for (file, version, expected) in known_replies() {
        let path = format!("{}/tests/data/{file}.answer", env!("CARGO_MANIFEST_DIR"));
        let bytes = std::fs::read(path).expect("the known answer");
        let read = Answer::decode(&bytes).expect("a version that is read");
        assert_eq!(read, expected);
        assert!(written(&read, version) == bytes, "{file} is written otherwise now");
    }
}

/// Only a doubtful pose is withheld, and only version 3 can say so.
#[test]
fn a_doubtful_pose_can_be_withheld() {
    let trusted = answer_in(AnswerVersion::Full, 1, 0);
    assert_eq!(trusted.clone().trusted_only(), trusted);
    let withheld = answer_in(AnswerVersion::Full, 1, 2).trusted_only();
    assert_eq!((withheld.pose, withheld.doubts.len(), withheld.state()), (None, 2, AnswerState::Doubtful));
    for version in [AnswerVersion::Plain, AnswerVersion::Padded] {
        let refused = withheld.encode(version);
        assert!(matches!(refused, Err(QueryError::Unsayable { .. })), "{refused:?}");
    }
    let bytes = written(&withheld, AnswerVersion::Full);
    assert_eq!(Answer::decode(&bytes), Ok(withheld.clone()));
    // An answer that is trusted and has no pose, or has a part of one, is none.
    let lying = Answer { trusted: true, doubts: Vec::new(), ..withheld };
    let refused = Answer::decode(&written(&lying, AnswerVersion::Full));
    assert!(matches!(refused, Err(QueryError::Length { field: "rotation", .. })), "{refused:?}");
    let whole = written(&answer_in(AnswerVersion::Full, 1, 2), AnswerVersion::Full);
    let rotation = 2 + 4 * 8; // key, length, four numbers, behind the version
    let part = [&whole[..5], &whole[5 + rotation..]].concat();
    assert!(matches!(Answer::decode(&part), Err(QueryError::NotCanonical { .. })));
    let wrong = |noise_px, focal_scale| {
        let fit = Some(AnswerFit { noise_px, focal_scale });
        Answer::decode(&written(&Answer { fit, ..answer(1, 0) }, AnswerVersion::Full))
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
    assert_eq!(Answer::decode(&written(&answer(1, 0), AnswerVersion::Full)), Ok(answer(1, 0)));
}

#[test]
fn the_position_sd_is_that_of_the_least_certain_direction() {
    let mut pose = answer(1, 0).pose.expect("a pose");
    // Turned about the third axis by 30 degrees: variances 4, 1 and 0.25 along the turned axes.
    let (s, c) = (0.5, 0.75_f64.sqrt());
    pose.center_covariance =
        [[4.0 * c * c + s * s, 3.0 * s * c, 0.0], [3.0 * s * c, 4.0 * s * s + c * c, 0.0], [0.0, 0.0, 0.25]];
    assert!((pose.position_sd() - 2.0).abs() < 1e-12, "{}", pose.position_sd());
    pose.center_covariance[2][2] = f64::INFINITY;
    assert!(pose.position_sd().is_infinite());
}

#[test]
fn wrong_answers_are_named() {
    type Change = fn(&mut Answer);
    let refused = |change: Change| {
        let mut wrong = answer(1, 1);
        change(&mut wrong);
        let [plain, padded, full] =
            AnswerVersion::ALL.map(|v| Answer::decode(&written(&wrong, v)).expect_err("refused"));
        assert_eq!([plain.to_string(), plain.to_string()], [padded.to_string(), full.to_string()]);
        plain
    };
    fn pose(answer: &mut Answer) -> &mut AnswerPose {
        answer.pose.as_mut().expect("a pose")
    }
    let cases: [(Change, &str); 6] = [
        (|a| pose(a).rotation[0] = 0.6, "rotation"),
        (|a| pose(a).rotation[2] = f64::NAN, "rotation"),
        (|a| pose(a).translation[1] = f64::INFINITY, "translation"),
        (|a| pose(a).covariance[2][3] = f64::NAN, "covariance"),
        (|a| a.margin = f64::NAN, "margin"),
        (|a| a.times.match_ms = -1.0, "milliseconds"),
    ];
    for (change, field) in cases {
        let error = refused(change);
        assert!(matches!(error, QueryError::Mismatch { what, .. } if what == field), "{field}: {error}");
    }
    let [plain, padded, full] = AnswerVersion::ALL.map(|version| written(&answer_in(version, 1, 1), version));
    let versioned = |number: u8, bytes: &[u8]| [&[0x0D, number, 0, 0, 0], &bytes[5..]].concat();
    for unknown in [0, 4] {
        let refused = Answer::decode(&versioned(unknown, &plain)).expect_err("refused");
        assert!(
            matches!(refused, QueryError::Version { found, .. } if found == u32::from(unknown)),
            "{refused}"
        );
    }
    // The form of one version under the number of the other, padding that tells something, padding cut short.
    Answer::decode(&versioned(2, &plain)).expect_err("no padding");
    Answer::decode(&versioned(1, &padded)).expect_err("padding");
    Answer::decode(&versioned(2, &full)).expect_err("fields that version 2 does not have");
    let mut telling = padded.clone();
    telling[Answer::PADDED_BYTES - 1] = 1;
    Answer::decode(&telling).expect_err("padding of other bytes than zeros");
    for bytes in [plain, padded, full] {
        assert!(Answer::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err(), "trailing field");
        for cut in 0..bytes.len() {
            assert!(Answer::decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }
}

fn is_written_back(bytes: &[u8], answer: &Answer) -> bool {
    AnswerVersion::ALL.into_iter().any(|version| answer.encode(version).is_ok_and(|own| own == bytes))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_read_unchanged(bytes in prop::collection::vec(any::<u8>(), 0..700)) {
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert!(is_written_back(&bytes, &answer));
        }
    }

    #[test]
    fn damaged_answers_are_refused_or_read_unchanged(
        doubts in 0..4_usize,
        version in 0..3_usize,
        withheld: bool,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let version = AnswerVersion::ALL[version];
        let mut answer = answer_in(version, 9, doubts);
        if withheld && version == AnswerVersion::Full {
            answer = answer.trusted_only();
        }
        let mut bytes = written(&answer, version);
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert!(is_written_back(&bytes, &answer));
        }
    }
}
