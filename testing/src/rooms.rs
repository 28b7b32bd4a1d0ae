//! A map of rooms: images in a row, each of which sees the points in front of it.

use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Pixel, PlanePoint, Point3};
use veiloc_map::{BuildSettings, MapImage, MapModel, MapPoint, Observation};
use veiloc_protocol::Profile;

/// Maximum number of points per image.
const SEEN: u32 = 12;

/// `rooms` rooms with `images` images each. Image `i` of a room sees its points `2i` to `2i + 11`, so it shares two
/// points fewer with each image farther away; images of different rooms share no points, but look alike.
pub fn rooms(rooms: u32, images: u32) -> MapModel {
    let bytes = |seed: u32, count: usize| -> Vec<u8> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12_345);
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..count).map(|_| next()).collect()
    };
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, bytes(1, 4 * 128)).expect("rows");
    let vocabulary = Vocabulary::new(words).expect("words");
    let mut model = MapModel::empty(Profile::vlad(vocabulary.clone()), BuildSettings::default());
    model.cameras.push("PINHOLE,640,480,500,500,320,240".parse().expect("a camera"));
    model.cameras.push("PINHOLE,320,240,250,250,160,120".parse().expect("a camera"));
    let per_room = 2 * (images - 1) + SEEN;
    let at = |room: u32, point: u32| {
        Point3::new(0.5 * f64::from(point) + 500.0 * f64::from(room), f64::from(point % 5) - 2.0, 6.0)
    };
    for room in 0..rooms {
        for image in 0..images {
            let center = Vector3::new(f64::from(image) + 2.5 + 500.0 * f64::from(room), 0.0, 0.0);
            let pose = CameraFromWorld::new(Rotation3::identity(), -center);
            let points = 2 * image..2 * image + SEEN;
            let camera = (image % 2) as usize;
            let keypoint = |point: u32| {
                let plane =
                    PlanePoint::from_camera_point(&pose.transform(&at(room, point))).expect("in front");
                let Pixel { u, v, .. } = model.cameras[camera].project(plane);
                [u as f32, v as f32]
            };
            let rows: Vec<u8> = points.clone().flat_map(|point| bytes(100 + point, 128)).collect();
            let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("rows");
            model.images.push(MapImage {
                name: format!("room{room}/{image:03}.jpg"),
                camera,
                cam_from_world: pose,
                keypoints: points.map(keypoint).collect(),
                global: vocabulary.aggregate(descriptors.view()),
                descriptors,
                point_of_keypoint: vec![None; SEEN as usize],
            });
        }
        for point in 0..per_room {
            let seen = (0..images).filter(|image| (2 * image..2 * image + SEEN).contains(&point));
            let track = seen
                .map(|image| Observation { image: room * images + image, keypoint: point - 2 * image })
                .collect();
            model.points.push(MapPoint { position: at(room, point), track, error: 0.25 });
        }
    }
    model.link_keypoints();
    model
}
