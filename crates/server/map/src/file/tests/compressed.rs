//! Tests of the section of compressed maps: known answer, and forged records.

use super::{forged, known_answer, open_bytes, sample};
use crate::file::layout::Section;
use crate::file::write::to_bytes;
use crate::{MapError, MapFile, MapModel, MapView, PointId, PointSummary, WholeMapSummary};

fn compressed(points: usize) -> WholeMapSummary {
    let summary = |i: usize| PointSummary {
        seen_by: 9 + i as u32,
        covariance: [0.25, 0.125, 0.0, 0.5, -0.0625, 2.0 + i as f32],
    };
    WholeMapSummary {
        bytes: 123_456,
        keypoints: 789,
        points: 55,
        of_points: (0..points).map(summary).collect(),
        packed_from: None,
    }
}

/// A compressed map.
pub(super) fn small(seed: u64) -> MapModel {
    let model = sample(seed, 3, 6, 4);
    let down = Some("-y".parse().unwrap());
    MapModel { compressed: Some(compressed(model.points.len())), down, ..model }
}

#[test]
fn known_answer_of_compressed() {
    let path = known_answer("map-compressed");
    let model = small(7);
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.to_model(), model);
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    // The server uses the stored summaries.
    let (id, view) = (PointId(1), MapView::from(&map));
    assert_eq!((view.seen_by(id), map.track_length(id)), (10, model.points[1].track.len()));
    assert_eq!(view.point_covariance(id)[2], [0.0, -0.0625, 3.0]);
}

#[test]
fn forged_records_are_refused() {
    let bytes = to_bytes(&small(8));
    let head = 24;
    let cases: [(&str, usize, Vec<u8>); 4] = [
        ("seen by none", head, 0_u32.to_le_bytes().into()),
        ("NaN", head + 4, f32::NAN.to_le_bytes().into()),
        ("no covariance", head + 28 + 4, (-1.0_f32).to_le_bytes().into()),
        ("fewer points than were kept", 16, 1_u64.to_le_bytes().into()),
    ];
    for (case, at, value) in cases {
        let error = forged(&bytes, Section::Compressed, |b| b[at..at + value.len()].copy_from_slice(&value));
        let error = error.expect_err(case);
        assert!(matches!(error, MapError::Structure { section: "compressed", .. }), "{case}: {error}");
    }
}

#[test]
fn one_record_per_point_is_required() {
    for points in [0, 1, 9] {
        let model = MapModel { compressed: Some(compressed(points)), ..sample(8, 3, 4, 3) };
        if points == model.points.len() {
            continue;
        }
        let error = open_bytes(&to_bytes(&model)).expect_err("not one per point");
        assert!(matches!(error, MapError::Structure { section: "compressed", .. }), "{error}");
    }
}
