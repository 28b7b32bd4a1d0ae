//! The pack of a map: all descriptors of points, and nothing else of the map.

use veiloc_descriptor::PointImage as _;
use veiloc_geometry::{CameraFromWorld, Point3};

use super::sample;
use crate::{MapFile, MapModel, PointId};

fn opened(model: &MapModel) -> MapFile {
    MapFile::of_model(model).expect("a map")
}

#[test]
fn every_row_of_a_point_is_in_the_pack() {
    let model = sample(4, 5, 40, 30);
    let map = opened(&model);
    let (pack, points) = map.pack().expect("it has points");
    assert_eq!((points.len(), pack.row_count()), (model.points.len(), map.observation_count()));
    assert_eq!((points.id(), pack.image_count()), (pack.id(), 5));
    // Each row of the pack is one of the point that the server takes it for.
    for image in 0..pack.image_count() {
        let view = pack.image(image);
        for (row, number) in view.points().iter().enumerate() {
            let id = points.point(*number).expect("a point of the map");
            let is_same = |o: crate::Observation| {
                map.image(o.image as usize).descriptors().row(o.keypoint as usize)
                    == view.descriptors().row(row)
            };
            assert!(map.track(id).any(is_same), "image {image} row {row}");
        }
    }
    assert_eq!(points.point(points.len() as u32), None);
    assert_eq!(map.pack_points().expect("it has points").id(), pack.id());
}

/// The pack is the same wherever points, keypoints and cameras are, whatever the images are called, and in whichever
/// order images and points were added: it says nothing of these.
#[test]
fn a_pack_has_no_position_name_or_order() {
    let model = sample(4, 5, 40, 30);
    let expected = opened(&model).pack().expect("it has points").0.encode();
    let mut moved = model.clone();
    for (i, image) in moved.images.iter_mut().enumerate() {
        image.name = format!("{i}.png");
        image.cam_from_world = CameraFromWorld::identity();
        image.keypoints.iter_mut().for_each(|keypoint| *keypoint = [1.0, 2.0]);
    }
    moved.points.iter_mut().for_each(|point| {
        point.position = Point3::new(0.0, 0.0, 5.0);
        point.error = 0.0;
    });
    assert!(opened(&moved).pack().expect("it has points").0.encode() == expected);

    let mut reordered = model;
    reordered.images.reverse();
    reordered.points.reverse();
    let last = reordered.images.len() as u32 - 1;
    for point in &mut reordered.points {
        point.track.iter_mut().for_each(|o| o.image = last - o.image);
        point.track.sort();
    }
    for image in &mut reordered.images {
        image.point_of_keypoint.iter_mut().for_each(|point| *point = None);
    }
    reordered.link_keypoints();
    let map = opened(&reordered);
    let (pack, points) = map.pack().expect("it has points");
    assert!(pack.encode() == expected, "an order shows");
    assert_ne!(points.point(0), Some(PointId(0)), "the test did not change the order");
}

#[test]
fn a_map_without_points_has_no_pack() {
    assert!(opened(&sample(4, 2, 10, 0)).pack().is_err());
}
