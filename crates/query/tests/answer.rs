//! The answer message: what the schema says, pinned, and strict towards any bytes.

mod common;

use common::answer;
use proptest::prelude::*;
use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use veiloc_query::{Answer, AnswerVersion, QueryError};

#[test]
fn answers_are_what_the_schema_says() {
    let proto = concat!(env!("CARGO_MANIFEST_DIR"), "/../../proto");
    let set = protox::compile(["veiloc/v1/answer.proto"], [proto]).expect("the schema compiles");
    let pool = DescriptorPool::from_file_descriptor_set(set).expect("complete");
    let descriptor = pool.get_message_by_name("veiloc.v1.Answer").expect("in the schema");
    for (doubts, version) in (0..6).flat_map(|n| AnswerVersion::ALL.map(|version| (n, version))) {
        let ours = answer(3, doubts);
        let bytes = ours.encode(version);
        let message = DynamicMessage::decode(descriptor.clone(), bytes.as_slice()).expect("such a message");
        assert_eq!(message.unknown_fields().count(), 0, "fields that the schema lacks");
        for field in descriptor.fields() {
            let expected = match field.name() {
                "doubts" => doubts > 0,
                "padding" => version == AnswerVersion::Padded,
                _ => true,
            };
            assert_eq!(message.has_field(&field), expected, "{}", field.full_name());
        }
        assert_eq!(message.encode_to_vec(), bytes);
        let value = |name: &str| message.get_field_by_name(name).expect("in the schema").into_owned();
        let list = |values: &[f64]| Value::List(values.iter().map(|v| Value::F64(*v)).collect());
        assert_eq!(value("version"), Value::U32(version.number()));
        assert_eq!(value("rotation"), list(&ours.rotation));
        assert_eq!(value("covariance"), list(&ours.covariance.concat()));
        assert_eq!(value("milliseconds"), list(&[0.25, 0.5, 12.0, 3.75]));
        assert_eq!(value("trusted"), Value::U32(u32::from(doubts == 0)));
        assert_eq!((value("inliers"), value("matches")), (Value::U32(311), Value::U32(912)));
        let told = value("doubts").as_list().expect("a list").len();
        assert_eq!(told, doubts);
        assert_eq!(Answer::decode(&bytes).expect("own bytes"), ours);
    }
}

/// L12: the length of a padded answer does not tell how many doubts are in it, nor how long their words are.
#[test]
fn padded_answers_have_one_length() {
    for doubts in 0..12 {
        for words in [0, 1, 100, 200] {
            let mut answer = answer(7, doubts);
            answer.doubts.iter_mut().for_each(|doubt| doubt.text = "w".repeat(words));
            assert_eq!(answer.encode(AnswerVersion::Padded).len(), Answer::PADDED_BYTES, "{doubts}, {words}");
        }
    }
    // Longer ones, which our server does not make, take the next whole number; around each step too.
    for words in 0..12_000 {
        let mut answer = answer(7, 1);
        answer.doubts[0].text = "w".repeat(words);
        let bytes = answer.encode(AnswerVersion::Padded);
        assert_eq!(bytes.len() % Answer::PADDED_BYTES, 0, "{words}");
        assert_eq!(Answer::decode(&bytes).as_ref(), Ok(&answer), "{words}");
    }
}

/// Each version, pinned byte for byte: every later program must read it and write it back unchanged.
#[test]
fn every_version_is_read_and_written_for_ever() {
    for version in AnswerVersion::ALL {
        let path = format!("{}/tests/data/v{}.answer", env!("CARGO_MANIFEST_DIR"), version.number());
        let bytes = std::fs::read(path).expect("the known answer");
        let read = Answer::decode(&bytes).expect("a version that is read");
        assert_eq!(read, answer(1, 2));
        assert!(read.encode(version) == bytes, "answers of {version:?} are written otherwise now");
    }
}

#[test]
fn wrong_answers_are_named() {
    type Change = fn(&mut Answer);
    let refused = |change: Change| {
        let mut wrong = answer(1, 1);
        change(&mut wrong);
        let [plain, padded] =
            AnswerVersion::ALL.map(|v| Answer::decode(&wrong.encode(v)).expect_err("refused"));
        assert_eq!(plain.to_string(), padded.to_string());
        plain
    };
    let cases: [(Change, &str); 6] = [
        (|a| a.rotation[0] = 0.6, "rotation"),
        (|a| a.rotation[2] = f64::NAN, "rotation"),
        (|a| a.translation[1] = f64::INFINITY, "translation"),
        (|a| a.covariance[2][3] = f64::NAN, "covariance"),
        (|a| a.margin = f64::NAN, "margin"),
        (|a| a.times.match_ms = -1.0, "milliseconds"),
    ];
    for (change, field) in cases {
        let error = refused(change);
        assert!(matches!(error, QueryError::Mismatch { what, .. } if what == field), "{field}: {error}");
    }
    let [plain, padded] = AnswerVersion::ALL.map(|version| answer(1, 1).encode(version));
    let versioned = |number: u8, bytes: &[u8]| [&[0x0D, number, 0, 0, 0], &bytes[5..]].concat();
    for unknown in [0, 3] {
        let refused = Answer::decode(&versioned(unknown, &plain)).expect_err("refused");
        assert!(
            matches!(refused, QueryError::Version { found, .. } if found == u32::from(unknown)),
            "{refused}"
        );
    }
    // The form of one version under the number of the other, padding that tells something, padding cut short.
    Answer::decode(&versioned(2, &plain)).expect_err("no padding");
    Answer::decode(&versioned(1, &padded)).expect_err("padding");
    let mut telling = padded.clone();
    telling[Answer::PADDED_BYTES - 1] = 1;
    Answer::decode(&telling).expect_err("padding of other bytes than zeros");
    for bytes in [plain, padded] {
        assert!(Answer::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err(), "trailing field");
        for cut in 0..bytes.len() {
            assert!(Answer::decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }
}

fn is_written_back(bytes: &[u8], answer: &Answer) -> bool {
    AnswerVersion::ALL.into_iter().any(|version| answer.encode(version) == bytes)
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
        padded: bool,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = answer(9, doubts).encode(AnswerVersion::ALL[usize::from(padded)]);
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert!(is_written_back(&bytes, &answer));
        }
    }
}
