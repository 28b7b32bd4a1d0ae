//! Tests of the self-test section: known answer, forged numbers, arbitrary bytes.

use proptest::prelude::*;
use veiloc_protocol::Scheme;

use super::{forged, known_answer, open_bytes, sample};
use crate::file::layout::Section;
use crate::file::write::to_bytes;
use crate::{
    CameraErrors, ConfidenceCoverage, CovarianceCalibration, MapError, MapFile, MapModel, SchemeTest,
    SelfTest,
};

/// A self-test without default values.
fn self_test() -> SelfTest {
    let scheme_test = |(k, scheme): (u32, Scheme)| {
        let x = f64::from(k) + 1.0;
        SchemeTest {
            scheme,
            localized: 9,
            trusted: 8,
            within_of_scale: [k, k + 1, k + 2],
            within: [k + 3, k + 4],
            median_rotation_deg: 0.25 * x,
            median_translation: if k == 3 { f64::INFINITY } else { 0.5 * x },
            median_noise_px: 1.5,
            before: ConfidenceCoverage { center: [0.25, 0.5, 0.75], pose: [0.125, 0.25, 0.5] },
            after: ConfidenceCoverage { center: [0.5, 0.875, 1.0], pose: [0.5, 0.75, 1.0] },
            calibration: CovarianceCalibration {
                factor: 2.0 * x,
                rotation_floor: 0.001 * x,
                translation_floor: 0.25,
            },
            cameras: CameraErrors {
                sd: [0.01, 0.02, 0.03, 0.04, 0.05, 0.0625 * x],
                min_log_odds: 3.5,
                min_focal_gain: 0.25 * x,
            },
        }
    };
    SelfTest {
        images: 10,
        scale: 3.5,
        assumed_noise_px: 2.0,
        schemes: (0..).zip(Scheme::ALL).map(scheme_test).collect(),
    }
}

#[test]
fn known_answer_of_a_self_test() {
    let path = known_answer("map-self-test");
    let model = MapModel { self_test: Some(self_test()), ..sample(7, 3, 4, 3) };
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.self_test(), Some(&self_test()));
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    let Some(dcl) = self_test().of_scheme("dcl:horizontal".parse().unwrap()).copied() else { panic!() };
    assert_eq!(dcl.scheme, Scheme::default(), "one calibration for all layouts");
    // Without it, the file is unchanged.
    let without = MapModel { self_test: None, ..map.to_model() };
    assert_eq!(std::fs::read(known_answer("map")).unwrap(), to_bytes(&without));
}

#[test]
fn forged_self_tests_are_refused() {
    let model = MapModel { self_test: Some(self_test()), ..sample(8, 2, 5, 3) };
    let bytes = to_bytes(&model);
    let nan = f64::NAN.to_bits().to_le_bytes();
    let negative = (-1.0_f64).to_bits().to_le_bytes();
    let scheme = 24;
    for (what, at, with) in [
        ("scale", 0, &nan[..]),
        ("scale", 0, &negative),
        ("scale", 0, &f64::INFINITY.to_bits().to_le_bytes()),
        ("noise", 8, &nan),
        ("fewer images than were localized", 16, &3_u32.to_le_bytes()),
        ("number of schemes", 20, &3_u32.to_le_bytes()),
        ("number of schemes", 20, &u32::MAX.to_le_bytes()),
        ("scheme of no name", scheme, &9_u32.to_le_bytes()),
        ("scheme twice", scheme, &2_u32.to_le_bytes()),
        ("trusted", scheme + 8, &11_u32.to_le_bytes()),
        ("within", scheme + 24, &u32::MAX.to_le_bytes()),
        ("median", scheme + 32, &nan),
        ("median", scheme + 40, &negative),
        ("coverage", scheme + 56, &2.0_f64.to_bits().to_le_bytes()),
        ("coverage", scheme + 144, &nan),
        ("factor", scheme + 152, &0.0_f64.to_bits().to_le_bytes()),
        ("factor", scheme + 152, &f64::INFINITY.to_bits().to_le_bytes()),
        ("floor", scheme + 160, &negative),
        ("floor", scheme + 168, &nan),
    ] {
        let put = |bytes: &mut [u8]| bytes[at..at + with.len()].copy_from_slice(with);
        let error = forged(&bytes, Section::SelfTest, put).expect_err(what);
        assert!(matches!(error, MapError::Structure { section: "self-test", .. }), "{what}: {error}");
    }
    let mut impossible = model;
    impossible.self_test.as_mut().unwrap().schemes[1].calibration.factor = f64::NAN;
    assert!(impossible.validate().is_err(), "nor is it written");
}

proptest! {
    /// Arbitrary bytes in the section: refused, or a self-test that round-trips.
    #[test]
    fn arbitrary_bytes_of_a_self_test(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let bytes = to_bytes(&MapModel { self_test: Some(self_test()), ..sample(8, 1, 3, 1) });
        let edit = |section: &mut [u8]| {
            for (at, byte) in edits {
                let at = at.index(section.len());
                section[at] = byte;
            }
        };
        if let Ok(map) = forged(&bytes, Section::SelfTest, edit) {
            let again = open_bytes(&to_bytes(&map.to_model())).unwrap();
            prop_assert_eq!(again.self_test(), map.self_test());
        }
    }
}
