//! Converts a COLMAP model to posed images; its keypoints, errors and colours are dropped.

use std::collections::BTreeMap;

use super::model::ColmapModel;
use crate::posed::{PosedImage, PosedImages};

/// The images in model order, each with the points that its 2D points observe.
impl From<&ColmapModel> for PosedImages {
    fn from(model: &ColmapModel) -> Self {
        let index: BTreeMap<u64, u32> = model.points().iter().map(|p| p.id).zip(0..).collect();
        let images = model.images().iter().map(|image| PosedImage {
            name: image.name.clone(),
            camera: *model.camera_of(image),
            cam_from_world: image.cam_from_world,
            seen: image.points2d.iter().filter_map(|p| index.get(&p.point?).copied()).collect(),
        });
        // The other requirements of posed images were checked when the COLMAP model was made.
        let posed = Self::indexed(images.collect(), model.points().iter().map(|p| p.position).collect());
        posed.with_remarks(model.remarks().to_vec())
    }
}
