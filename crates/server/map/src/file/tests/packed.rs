//! Tests of packed maps: known answer, loss of precision, and forged records.

use super::{compressed::small, forged, known_answer, open_bytes};
use crate::file::layout::Section;
use crate::file::write::to_bytes;
use crate::{MapError, MapFile, MapModel, Observation};

/// A compressed map in which every keypoint has a point.
fn with_seeing_keypoints(seed: u64) -> MapModel {
    let mut model = small(seed);
    let mut moved = Vec::new();
    for image in &mut model.images {
        let seeing: Vec<usize> =
            (0..image.keypoints.len()).filter(|k| image.point_of_keypoint[*k].is_some()).collect();
        image.keypoints = seeing.iter().map(|k| image.keypoints[*k]).collect();
        image.descriptors = image.descriptors.select(seeing.iter().copied());
        moved.push(seeing);
    }
    for point in &mut model.points {
        for Observation { image, keypoint } in &mut point.track {
            let now = moved[*image as usize].iter().position(|k| *k == *keypoint as usize);
            *keypoint = now.expect("it sees the point") as u32;
        }
    }
    model.link_keypoints();
    model
}

fn packed(seed: u64) -> MapModel {
    let mut model = with_seeing_keypoints(seed);
    model.pack().unwrap();
    model
}

#[test]
fn known_answer_of_packed() {
    let path = known_answer("map-packed");
    let model = packed(7);
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.to_model(), model);
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    assert_eq!(map.byte_count(), to_bytes(&model).len() as u64);
}

#[test]
fn packing_loses_little_and_is_idempotent() {
    for seed in 0..20 {
        let before = with_seeing_keypoints(seed);
        let after = packed(seed);
        assert!(to_bytes(&after).len() < to_bytes(&before).len());
        for (was, is) in before.points.iter().zip(&after.points) {
            assert!((was.position.coords - is.position.coords).norm() < 1e-5);
            assert!((was.error - is.error).abs() < 1e-3);
            assert_eq!(was.track, is.track);
        }
        for (was, is) in before.images.iter().zip(&after.images) {
            assert_eq!((&was.name, was.cam_from_world, was.camera), (&is.name, is.cam_from_world, is.camera));
            assert_eq!(was.descriptors, is.descriptors);
            for (a, b) in was.keypoints.iter().flatten().zip(is.keypoints.iter().flatten()) {
                assert!((a - b).abs() < 0.02, "{a} {b}");
            }
            assert!(was.global.similarity(is.global.as_codes()) > 0.7);
        }
        let of = |model: &MapModel| model.compressed.clone().unwrap().of_points;
        for (was, is) in of(&before).iter().zip(of(&after)) {
            assert_eq!(was.seen_by, is.seen_by);
            for (a, b) in was.covariance.iter().zip(is.covariance) {
                assert!((a - b).abs() < 4e-3 * was.covariance[5], "{was:?} {is:?}");
            }
        }
        let mut again = after.clone();
        again.pack().unwrap();
        assert_eq!(again, after);
        assert_eq!(MapFile::of_model(&after).unwrap().to_model(), after);
        assert_eq!(open_bytes(&to_bytes(&after)).unwrap().to_model(), after);
    }
}

#[test]
fn precision_does_not_depend_on_the_origin() {
    let far = |offset: f64| {
        let mut model = with_seeing_keypoints(3);
        model.points.iter_mut().for_each(|p| p.position.coords.x += offset);
        model.pack().unwrap();
        model
    };
    for (near, far) in far(0.0).points.iter().zip(far(1e6).points) {
        assert!((far.position.coords.x - 1e6 - near.position.coords.x).abs() < 1e-5);
    }
}

/// Correlations of one, and sizes beyond the stored range: the result is a valid covariance.
#[test]
fn extreme_covariances_stay_valid() {
    let mut model = with_seeing_keypoints(5);
    for (id, of) in model.compressed.as_mut().unwrap().of_points.iter_mut().enumerate() {
        let c = [1e-30, 1e-9, 1.0, 1e25][id % 4];
        let needle = [[c, c, c], [c, c, c], [c, c, c]];
        *of = crate::PointSummary::new(9, &needle);
    }
    model.pack().unwrap();
    assert_eq!(open_bytes(&to_bytes(&model)).unwrap().to_model(), model);
}

#[test]
fn unsupported_maps_are_not_packed() {
    let mut plain = MapModel { compressed: None, ..with_seeing_keypoints(1) };
    let refused = plain.pack().unwrap_err().to_string();
    assert!(refused.contains("not compressed"), "{refused}");
    let refused = small(1).pack().unwrap_err().to_string();
    assert!(refused.contains("sees no point"), "{refused}");
}

#[test]
fn forged_records_are_refused() {
    let model = packed(8);
    let bytes = to_bytes(&model);
    let (points, head) = (model.points.len(), 40);
    let keypoints: usize = model.images.iter().map(|i| i.keypoints.len()).sum();
    let globals = head + points * 28 + keypoints * (8 + 128);
    let cases: [(&str, usize, Vec<u8>); 7] = [
        ("origin", 0, f64::NAN.to_le_bytes().into()),
        ("more points than bytes", 24, u64::MAX.to_le_bytes().into()),
        ("another number of keypoints", 32, (keypoints as u64 - 1).to_le_bytes().into()),
        ("more keypoints than bytes", 32, (u64::MAX / 2).to_le_bytes().into()),
        ("a position", head, f32::INFINITY.to_le_bytes().into()),
        ("no such point", head + points * 28, u32::MAX.to_le_bytes().into()),
        ("neither there nor not", globals, vec![2]),
    ];
    for (case, at, value) in cases {
        let error = forged(&bytes, Section::Packed, |b| b[at..at + value.len()].copy_from_slice(&value));
        let error = error.expect_err(case);
        assert!(matches!(error, MapError::Structure { .. }), "{case}: {error}");
    }
    // All keypoints refer to the first point, and none to the others.
    let keypoint_records = head + points * 28..globals - keypoints * 128;
    let error = forged(&bytes, Section::Packed, |b| {
        b[keypoint_records].chunks_exact_mut(8).for_each(|record| record[..4].fill(0));
    });
    let error = error.expect_err("points without observations");
    assert!(matches!(error, MapError::Structure { .. }), "{error}");
    let error =
        forged(&bytes, Section::Compressed, |b| b[16..24].fill(0)).expect_err("fewer points than kept");
    assert!(matches!(error, MapError::Structure { .. }), "{error}");
}
