//! Images and points of a COLMAP model.

use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Pixel, Point3};

/// A keypoint of a COLMAP image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint2d {
    /// Position in the original (distorted) image.
    pub pixel: Pixel,
    /// The observed 3D point.
    pub point: Option<u64>,
}

/// A posed image.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's id of the image.
    pub id: u32,
    /// File name, relative to the folder of the images.
    pub name: String,
    /// COLMAP's id of its camera.
    pub camera_id: u32,
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
    /// Its keypoints; tracks refer to them by index.
    pub points2d: Vec<ColmapPoint2d>,
}

/// A triangulated point.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapPoint {
    /// COLMAP's id of the point.
    pub id: u64,
    /// Position, map units.
    pub position: Point3<World>,
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Mean reprojection error over the track, pixels; -1 when COLMAP did not compute it.
    pub error: f64,
    /// Observations: image id, and index of the keypoint in that image.
    pub track: Vec<(u32, u32)>,
}
