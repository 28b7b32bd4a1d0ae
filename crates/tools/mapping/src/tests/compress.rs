//! Tests of compressed maps: their content, their stored statistics, and the changes they refuse.

use std::collections::BTreeSet;

use veiloc_map::{BuildSettings, MapFile, MapModel, PointId, byte_count};

use super::synthetic::{known_scene, map_of};
use crate::build::change::{VocabularyUpdate, remove};
use crate::compress::{CompressOptions, compress};
use crate::error::MappingError;

fn whole() -> MapModel {
    map_of(&known_scene(16, 400), &BuildSettings::default())
}

#[test]
fn compressed_map_fits_budget_and_is_a_subset() {
    let whole = whole();
    let file = MapFile::of_model(&whole).unwrap();
    for times in [6, 9] {
        let bytes = file.byte_count() / times;
        let small = compress(&whole, &CompressOptions::new(bytes), &()).unwrap();
        small.model.validate().unwrap();
        let spent = byte_count(&small.model);
        assert!(spent <= bytes && spent * 10 > bytes * 8, "{spent} of {bytes}");
        assert_eq!(small.model.profile.id(), whole.profile.id());
        assert_eq!(small.kept_points.len(), small.model.points.len());
        let compressed = small.model.compressed.as_ref().unwrap();
        assert_eq!((compressed.bytes, compressed.points), (file.byte_count(), whole.points.len() as u64));
        for ((id, point), remembered) in
            small.kept_points.iter().zip(&small.model.points).zip(&compressed.of_points)
        {
            let before = &whole.points[id.index()];
            // The scene is about ten units wide: 24 bits are a millionth of that.
            assert!((point.position.coords - before.position.coords).norm() < 1e-5);
            assert_eq!(remembered.seen_by as usize, before.track.len());
            assert!((1..=3).contains(&point.track.len()));
            let was = file.point_covariance(*id);
            for (a, b) in remembered.covariance().iter().flatten().zip(was.iter().flatten()) {
                let largest = (0..3).map(|i| was[i][i]).fold(0.0, f64::max);
                assert!((a - b).abs() <= 4e-3 * largest, "{a} {b}");
            }
            // Its keypoints and descriptors equal those of the whole map at the same pixels of the same images.
            for o in &point.track {
                let (now, then) = (&small.model.images[o.image as usize], &whole.images[o.image as usize]);
                let there = then.point_of_keypoint.iter().position(|p| *p == Some(*id)).unwrap();
                let [at, was] = [now.keypoints[o.keypoint as usize], then.keypoints[there]];
                assert!((at[0] - was[0]).abs() < 0.01 && (at[1] - was[1]).abs() < 0.01, "{at:?} {was:?}");
                assert_eq!(now.descriptors.row(o.keypoint as usize), then.descriptors.row(there));
            }
        }
    }
}

/// Every image keeps points in all its parts; otherwise it would be useless for localization.
#[test]
fn every_image_keeps_points() {
    let whole = whole();
    let bytes = byte_count(&whole) / 6;
    let small = compress(&whole, &CompressOptions::new(bytes), &()).unwrap();
    let kept_points: BTreeSet<PointId> = small.kept_points.iter().copied().collect();
    let share = kept_points.len() as f64 / whole.points.len() as f64;
    for image in &whole.images {
        let seen = |half: bool| {
            let there = |(k, p): (&[f32; 2], &Option<PointId>)| {
                p.is_some_and(|p| kept_points.contains(&p)) && (k[0] > 320.0) == half
            };
            image.keypoints.iter().zip(&image.point_of_keypoint).filter(|(k, p)| there((*k, *p))).count()
        };
        let all = image.point_of_keypoint.iter().flatten().count() as f64;
        let (left, right) = (seen(false), seen(true));
        assert!((left + right) as f64 > 0.6 * share * all, "{}: {left} {right} of {all}", image.name);
        assert!(left >= 5 && right >= 5, "{}: {left} {right}", image.name);
    }
}

#[test]
fn result_is_independent_of_thread_count() {
    let whole = whole();
    let bytes = byte_count(&whole) / 4;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| compress(&whole, &CompressOptions::new(bytes), &()).unwrap())
    };
    assert_eq!(with(1), with(4));
}

#[test]
fn fewer_descriptors_allow_more_points() {
    let whole = whole();
    let bytes = byte_count(&whole) / 9;
    let points = |descriptors: usize| {
        let options = CompressOptions::new(bytes).with_descriptors(descriptors);
        compress(&whole, &options, &()).unwrap().kept_points.len()
    };
    assert!(points(1) > points(3) && points(3) > points(8), "{} {} {}", points(1), points(3), points(8));
}

#[test]
fn impossible_sizes_and_changes_are_refused() {
    let whole = whole();
    for bytes in [0, 1, 4000] {
        let refused = compress(&whole, &CompressOptions::new(bytes), &()).unwrap_err();
        let MappingError::TooSmall { least, .. } = refused else { panic!("{refused}") };
        assert!(compress(&whole, &CompressOptions::new(least + 2000), &()).is_ok());
    }
    let mut small = compress(&whole, &CompressOptions::new(byte_count(&whole) / 3), &()).unwrap().model;
    let again = compress(&small, &CompressOptions::new(byte_count(&small) / 2), &()).unwrap_err();
    assert!(matches!(again, MappingError::Compressed), "{again}");
    let before = small.clone();
    let names = [small.images[3].name.clone()];
    let refused = remove(&mut small, &names, VocabularyUpdate::Keep, &()).unwrap_err();
    assert!(matches!(refused, MappingError::Compressed), "{refused}");
    assert_eq!(small, before);
}
