//! Exports a map as a COLMAP model.

use veiloc_geometry::Pixel;

use super::model::ColmapModel;
use super::records::{ColmapImage, ColmapPoint, ColmapPoint2d};
use crate::error::MapError;
use crate::model::MapModel;

/// The COLMAP model of a map: images and points numbered from 1 in map order, points gray.
///
/// # Errors
/// [`MapError::Model`]: the map is inconsistent.
pub fn export(map: &MapModel) -> Result<ColmapModel, MapError> {
    map.validate()?;
    let cameras = (1..).zip(map.cameras.iter().copied()).collect();
    let images = (1..)
        .zip(&map.images)
        .map(|(id, image)| ColmapImage {
            id,
            name: image.name.clone(),
            camera_id: image.camera as u32 + 1,
            cam_from_world: image.cam_from_world,
            points2d: image
                .keypoints
                .iter()
                .zip(&image.point_of_keypoint)
                .map(|([u, v], point)| ColmapPoint2d {
                    pixel: Pixel::new(f64::from(*u), f64::from(*v)),
                    point: point.map(|p| u64::from(p.0) + 1),
                })
                .collect(),
        })
        .collect();
    let points = (1..)
        .zip(&map.points)
        .map(|(id, point)| ColmapPoint {
            id,
            position: point.position,
            color: [128; 3],
            error: point.error,
            track: point.track.iter().map(|o| (o.image + 1, o.keypoint)).collect(),
        })
        .collect();
    ColmapModel::new(cameras, images, points)
}
