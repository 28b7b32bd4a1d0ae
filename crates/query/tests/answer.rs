//! The answer message: what the schema says, pinned, and strict towards any bytes.

mod common;

use common::answer;
use proptest::prelude::*;
use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use veiloc_query::{Answer, QueryError};

#[test]
fn answers_are_what_the_schema_says() {
    let proto = concat!(env!("CARGO_MANIFEST_DIR"), "/../../proto");
    let set = protox::compile(["veiloc/v1/answer.proto"], [proto]).expect("the schema compiles");
    let pool = DescriptorPool::from_file_descriptor_set(set).expect("complete");
    let descriptor = pool.get_message_by_name("veiloc.v1.Answer").expect("in the schema");
    for doubts in 0..6 {
        let ours = answer(3, doubts);
        let bytes = ours.encode();
        let message = DynamicMessage::decode(descriptor.clone(), bytes.as_slice()).expect("such a message");
        assert_eq!(message.unknown_fields().count(), 0, "fields that the schema lacks");
        for field in descriptor.fields() {
            assert!(message.has_field(&field) || field.name() == "doubts", "{}", field.full_name());
        }
        assert_eq!(message.encode_to_vec(), bytes);
        let value = |name: &str| message.get_field_by_name(name).expect("in the schema").into_owned();
        let list = |values: &[f64]| Value::List(values.iter().map(|v| Value::F64(*v)).collect());
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

/// Version 1, pinned byte for byte: every later program must read it and write it back unchanged.
#[test]
fn version_1_is_read_and_written_for_ever() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/v1.answer");
    let bytes = std::fs::read(path).expect("the known answer");
    let read = Answer::decode(&bytes).expect("version 1");
    assert_eq!(read, answer(1, 2));
    assert!(read.encode() == bytes, "answers are written otherwise now");
}

#[test]
fn wrong_answers_are_named() {
    type Change = fn(&mut Answer);
    let refused = |change: Change| {
        let mut wrong = answer(1, 1);
        change(&mut wrong);
        Answer::decode(&wrong.encode()).expect_err("refused")
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
    let bytes = answer(1, 1).encode();
    let next = [&[0x0D, 2, 0, 0, 0], &bytes[5..]].concat();
    assert!(matches!(Answer::decode(&next), Err(QueryError::Version { found: 2, .. })));
    assert!(Answer::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err(), "trailing field");
    for cut in 0..bytes.len() {
        assert!(Answer::decode(&bytes[..cut]).is_err(), "cut at {cut}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_read_unchanged(bytes in prop::collection::vec(any::<u8>(), 0..700)) {
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert_eq!(answer.encode(), bytes);
        }
    }

    #[test]
    fn damaged_answers_are_refused_or_read_unchanged(
        doubts in 0..4_usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = answer(9, doubts).encode();
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert_eq!(answer.encode(), bytes);
        }
    }
}
