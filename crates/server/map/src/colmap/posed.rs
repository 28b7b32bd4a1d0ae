//! A COLMAP model as posed images: what it adds to them (its own keypoints, errors, colours) is left behind.

use std::collections::BTreeMap;

use super::model::ColmapModel;
use crate::posed::{PosedImage, PosedImages};

/// The model's images in its order, each with the points that its 2D points see.
impl From<&ColmapModel> for PosedImages {
    fn from(model: &ColmapModel) -> Self {
        let index: BTreeMap<u64, u32> = model.points().iter().map(|p| p.id).zip(0..).collect();
        let images = model.images().iter().map(|image| PosedImage {
            name: image.name.clone(),
            camera: *model.camera_of(image),
            cam_from_world: image.cam_from_world,
            seen: image.points2d.iter().filter_map(|p| index.get(&p.point?).copied()).collect(),
        });
        // What else posed images must fulfil, a COLMAP model was asked for when it was made.
        Self::indexed(images.collect(), model.points().iter().map(|p| p.position).collect())
    }
}
