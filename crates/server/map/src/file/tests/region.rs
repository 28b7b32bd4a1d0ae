//! Tests of the section of regions: known answer, forged records, and agreement with the whole map.

use super::compressed::small;
use super::{forged, known_answer, open_bytes, sample};
use crate::file::layout::Section;
use crate::file::write::to_bytes;
use crate::{MapError, MapFile, MapModel, MapView, PointId, Region, RegionImage};

fn region() -> Region {
    let image = |whole, is_core| RegionImage { whole, is_core };
    Region { images: 9, of_images: vec![image(2, true), image(3, false), image(7, true)] }
}

/// A region.
pub(super) fn part(seed: u64) -> MapModel {
    MapModel { region: Some(region()), ..small(seed) }
}

#[test]
fn known_answer_of_a_region() {
    let path = known_answer("map-region");
    let model = part(7);
    if std::env::var_os("VEILOC_BLESS").is_some() {
        std::fs::write(&path, to_bytes(&model)).unwrap();
    }
    let map = MapFile::open(&path).unwrap();
    assert_eq!(map.to_model(), model);
    assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&model));
    assert_eq!(map.part_of(), Some(&region()));
}

#[test]
fn forged_records_are_refused() {
    let bytes = to_bytes(&part(8));
    let head = 8;
    for (case, at, value) in [
        ("reserved", 4, 1_u32),
        ("beyond the whole map", head + 16, 9),
        ("not rising", head, 3),
        ("no flag", head + 4, 2),
        ("fewer images", 0, 7),
    ] {
        let error = forged(&bytes, Section::Region, |b| b[at..at + 4].copy_from_slice(&value.to_le_bytes()));
        let error = error.expect_err(case);
        assert!(matches!(error, MapError::Structure { section: "region", .. }), "{case}: {error}");
    }
    let without_core = forged(&bytes, Section::Region, |b| {
        for at in [head + 4, head + 20] {
            b[at] = 0;
        }
    });
    assert!(without_core.is_err());
}

#[test]
fn region_needs_one_record_per_image_and_summaries() {
    let fewer = Region { of_images: region().of_images[..2].to_vec(), ..region() };
    let forgetful = MapModel { compressed: None, ..part(8) };
    for model in [MapModel { region: Some(fewer), ..part(8) }, forgetful] {
        assert!(model.validate().is_err());
        let error = open_bytes(&to_bytes(&model)).expect_err("no region");
        assert!(matches!(error, MapError::Structure { section: "region", .. }), "{error}");
    }
}

/// A region has the data of the whole map for its images.
#[test]
fn region_agrees_with_the_whole_map() {
    let whole = MapFile::of_model(&sample(3, 7, 9, 9)).unwrap();
    let image = |whole, is_core| RegionImage { whole, is_core };
    let part = Region { images: 7, of_images: vec![image(0, false), image(4, true), image(5, true)] };
    let model = whole.region(part.clone()).unwrap();
    let region = MapFile::of_model(&model).unwrap();
    assert_eq!(region.part_of(), Some(&part));
    assert_eq!(region.profile().encode(), whole.profile().encode());
    let ids: Vec<PointId> = (0..whole.point_count() as u32)
        .map(PointId)
        .filter(|id| whole.track(*id).any(|o| [0, 4, 5].contains(&o.image)))
        .collect();
    assert_eq!(region.point_count(), ids.len());
    for (own, id) in (0..).map(PointId).zip(ids) {
        assert_eq!(region.point(own), whole.point(id));
        assert_eq!(region.reprojection_error(own), whole.reprojection_error(id));
        let (view, wide) = (MapView::from(&region), MapView::from(&whole));
        assert_eq!(view.seen_by(own), wide.seen_by(id));
        for (a, b) in
            view.point_covariance(own).iter().flatten().zip(wide.point_covariance(id).iter().flatten())
        {
            assert!((a - b).abs() <= 1e-4 * b.abs().max(wide.point_covariance(id)[0][0]), "{a} {b}");
        }
        let seen: Vec<(u32, u32)> =
            region.track(own).map(|o| (part.of_images[o.image as usize].whole, o.keypoint)).collect();
        let expected: Vec<(u32, u32)> =
            whole.track(id).filter(|o| [0, 4, 5].contains(&o.image)).map(|o| (o.image, o.keypoint)).collect();
        assert_eq!(seen, expected);
    }
    for (own, of) in region.images().zip(&part.of_images) {
        let there = whole.image(of.whole as usize);
        assert_eq!((own.name(), own.global(), own.camera()), (there.name(), there.global(), there.camera()));
        assert_eq!(own.keypoints(), there.keypoints());
        assert_eq!(own.descriptors().to_owned(), there.descriptors().to_owned());
    }
}

#[test]
fn invalid_regions_are_refused() {
    let whole = MapFile::of_model(&sample(3, 7, 9, 9)).unwrap();
    let image = |whole| RegionImage { whole, is_core: true };
    for (images, of_images) in
        [(8, vec![image(1)]), (7, vec![image(7)]), (7, vec![]), (7, vec![image(2), image(1)])]
    {
        assert!(matches!(whole.region(Region { images, of_images }), Err(MapError::Model { .. })));
    }
    let one = whole.region(Region { images: 7, of_images: vec![image(1)] }).unwrap();
    let again = MapFile::of_model(&one).unwrap().region(Region { images: 1, of_images: vec![image(0)] });
    assert!(again.unwrap_err().to_string().contains("cut the whole map"));
}
