//! Places that look alike: a map with a copy of a part of it at another position.

use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Point3};
use veiloc_map::{MapImage, MapModel, MapPoint, Observation};

/// The map with a copy of its first `count` images and of the points that at least two of them see, moved by `away` (map
/// units). The names of the copies begin with `copy/`.
///
/// # Panics
/// When the map has fewer images.
pub fn with_copy(map: &MapModel, count: usize, away: Vector3<f64>) -> MapModel {
    let mut model = map.clone();
    let first = map.images.len() as u32;
    for image in &map.images[..count] {
        let (rotation, translation) = (image.cam_from_world.rotation(), image.cam_from_world.translation());
        model.images.push(MapImage {
            name: format!("copy/{}", image.name),
            cam_from_world: CameraFromWorld::new(*rotation, translation - rotation * away),
            point_of_keypoint: vec![None; image.keypoints.len()],
            ..image.clone()
        });
    }
    for point in &map.points {
        let seen = point.track.iter().filter(|o| (o.image as usize) < count);
        let track: Vec<Observation> =
            seen.map(|o| Observation { image: first + o.image, keypoint: o.keypoint }).collect();
        if track.len() >= 2 {
            let position = Point3::from_vector(point.position.coords + away);
            model.points.push(MapPoint { position, track, error: point.error });
        }
    }
    model.link_keypoints();
    model
}
