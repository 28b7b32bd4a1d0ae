//! A scene of a data set: map images and queries.

use std::path::PathBuf;

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::PosedImages;

/// A scene of a data set.
#[derive(Debug, Clone)]
pub struct DatasetScene {
    /// Its name: that of the scene, or of a data set with one scene.
    pub name: String,
    /// Folder of the images; their names are relative to it.
    pub images: PathBuf,
    /// The map images, with cameras and poses.
    pub mapped: PosedImages,
    /// The query images, in the order of their list.
    pub queries: Vec<DatasetQuery>,
    /// Whether this is the complete published scene, so that published figures refer to the same images. Determined
    /// by the numbers of images.
    pub is_official: bool,
    /// What was left out or assumed while reading, one sentence each.
    pub remarks: Vec<String>,
}

/// A query image.
#[derive(Debug, Clone, PartialEq)]
pub struct DatasetQuery {
    /// Its name, relative to the folder of the images.
    pub name: String,
    /// Its camera.
    pub camera: Intrinsics,
    /// Its pose, if it is published.
    pub cam_from_world: Option<CameraFromWorld>,
    /// Its condition (`day`, `night`), if the data set distinguishes conditions.
    pub condition: Option<String>,
}
