//! A place of a data set: what a map is built from, and what is asked.

use std::path::PathBuf;

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::PosedImages;

/// A place of a data set.
#[derive(Debug, Clone)]
pub struct Place {
    /// Its name: that of the scene, or of the data set where it has one place.
    pub name: String,
    /// Folder that the names of images are relative to.
    pub images: PathBuf,
    /// The images that a map is built from, with cameras and poses.
    pub mapped: PosedImages,
    /// The images that are asked for, in the order of their list.
    pub queries: Vec<Query>,
    /// Whether this is the published place, whole: figures of others are of the same images. Judged by the numbers of images.
    pub is_official: bool,
    /// What was left out or decided while reading, a sentence each, for people.
    pub remarks: Vec<String>,
}

/// An image that asks for its place.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Its name, relative to the folder of the images.
    pub name: String,
    /// Its camera.
    pub camera: Intrinsics,
    /// Where it was taken, where that is published.
    pub cam_from_world: Option<CameraFromWorld>,
    /// What it was taken under (`day`, `night`), where the data set tells queries apart.
    pub condition: Option<String>,
}
