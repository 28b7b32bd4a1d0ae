//! Tests of the section of the gravity direction: known answer, forged numbers, and combinations of optional
//! sections.

use super::{forged, known_answer, open_bytes, sample, section};
use crate::file::layout::{Section, SectionEntry};
use crate::file::write::to_bytes;
use crate::{AlignmentAccuracy, GravityDirection, MapError, MapFile, MapModel, SelfTest};

fn down() -> GravityDirection {
    GravityDirection::new([0.5, -2.0, 0.25]).unwrap()
}

#[test]
fn known_answer_of_down() {
    let path = known_answer("map-down");
    let model = MapModel { down: Some(down()), ..sample(7, 3, 4, 3) };
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.down(), Some(down()));
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    // Without it, the file is unchanged.
    let without = MapModel { down: None, ..map.to_model() };
    assert_eq!(std::fs::read(known_answer("map")).unwrap(), to_bytes(&without));
}

#[test]
fn optional_sections_are_independent() {
    let test = SelfTest { images: 0, scale: 1.0, assumed_noise_px: 1.0, schemes: Vec::new() };
    for (self_test, down) in
        [(None, None), (Some(test.clone()), None), (None, Some(down())), (Some(test), Some(down()))]
    {
        let model = MapModel { self_test, down, ..sample(3, 2, 3, 2) };
        let map = open_bytes(&to_bytes(&model)).unwrap();
        assert_eq!(map.to_model(), model);
    }
}

#[test]
fn a_forged_direction_is_refused() {
    let bytes = to_bytes(&MapModel { down: Some(down()), ..sample(8, 2, 5, 3) });
    for number in [f64::NAN, f64::INFINITY, 0.0, 1.5, -7.0] {
        let put = |bytes: &mut [u8]| bytes[8..16].copy_from_slice(&number.to_le_bytes());
        let error = forged(&bytes, Section::Down, put).expect_err("no unit vector");
        assert!(matches!(error, MapError::Structure { section: "down", .. }), "{number}: {error}");
    }
}

#[test]
fn known_answer_of_a_metric_map() {
    let path = known_answer("map-metric");
    let model = MapModel { is_metric: true, ..sample(7, 3, 4, 3) };
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert!(map.is_metric());
    assert_eq!(map.to_model(), model);
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    assert!(!MapFile::open(&known_answer("map")).unwrap().is_metric());
}

#[test]
fn the_accuracy_of_an_alignment_is_kept_and_checked() {
    let accuracy = AlignmentAccuracy {
        scale: 0.01,
        tilt_deg: 1.5,
        heading_deg: 0.8,
        position: 0.4,
        center: [1.0, -2.0, 3.0],
    };
    let model = MapModel { alignment: Some(accuracy), ..sample(7, 3, 4, 3) };
    let bytes = to_bytes(&model);
    assert_eq!(open_bytes(&bytes).unwrap().to_model(), model);
    for (at, number) in [(0, f64::NAN), (1, -1.0), (3, f64::INFINITY), (6, f64::NAN)] {
        let put = |bytes: &mut [u8]| bytes[8 * at..8 * at + 8].copy_from_slice(&number.to_le_bytes());
        let error = forged(&bytes, Section::Alignment, put).expect_err("no accuracy");
        assert!(matches!(error, MapError::Structure { section: "alignment", .. }), "{at}: {error}");
    }
}

/// Shorter or longer by a number, with valid lengths and checksums.
#[test]
fn wrong_length_is_refused() {
    let bytes = to_bytes(&MapModel { down: Some(down()), ..sample(8, 2, 5, 3) });
    let (at, entry) = section(&bytes, Section::Down);
    for length in [0_u64, 16, 32] {
        let mut bytes = bytes.clone();
        bytes.resize((entry.offset + length) as usize, 0);
        let start = entry.offset as usize;
        let other = SectionEntry { length, checksum: xxhash_rust::xxh3::xxh3_64(&bytes[start..]), ..entry };
        bytes[at..at + size_of::<SectionEntry>()].copy_from_slice(zerocopy::IntoBytes::as_bytes(&other));
        let whole = (bytes.len() as u64).to_le_bytes();
        bytes[16..24].copy_from_slice(&whole);
        super::seal_header(&mut bytes);
        let error = open_bytes(&bytes).expect_err("not one direction");
        assert!(matches!(error, MapError::Structure { section: "down", .. }), "{length}: {error}");
    }
}
