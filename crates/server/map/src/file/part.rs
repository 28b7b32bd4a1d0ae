//! Extracts a region of a map as a map.

use std::collections::{BTreeMap, BTreeSet};

use super::view::MapFile;
use crate::compressed::{PointSummary, WholeMapSummary};
use crate::error::{MapError, ModelRecord};
use crate::model::{MapModel, MapPoint, Observation, PointId};
use crate::region::Region;

impl WholeMapSummary {
    /// The data that a map with these points of `whole` keeps about it.
    pub fn of(whole: &MapFile, kept: impl IntoIterator<Item = PointId>) -> Self {
        let summary = |id: PointId| PointSummary::new(whole.seen_by(id) as u32, &whole.point_covariance(id));
        Self {
            bytes: whole.byte_count(),
            keypoints: whole.images().map(|image| image.keypoints().len() as u64).sum(),
            points: whole.point_count() as u64,
            of_points: kept.into_iter().map(summary).collect(),
            packed_from: None,
        }
    }
}

impl MapFile {
    /// The map of these images: all of their keypoints, and the points that they observe.
    ///
    /// The summary of each point in the whole map is kept, so that a match has the same likelihood as there. Profile,
    /// settings, gravity direction and self-test (with the calibrations of the whole map) are equal. Images and
    /// points keep their order. Only the needed data is copied.
    ///
    /// # Errors
    /// [`MapError::Model`]: the map has no such images, or is a region itself.
    pub fn region(&self, region: Region) -> Result<MapModel, MapError> {
        let refuse = |reason: String| Err(MapError::Model { record: ModelRecord::Map, reason });
        if self.region.is_some() {
            return refuse(
                "is a region of a larger map, and regions cannot be cut again: cut the whole map".to_owned(),
            );
        }
        if region.images as usize != self.image_count() {
            return refuse(format!("has {} images, not {}", self.image_count(), region.images));
        }
        if let Err(reason) = region.check(region.of_images.len(), true) {
            return refuse(reason);
        }
        let wholes = || region.of_images.iter().map(|image| image.whole as usize);
        let cameras: BTreeSet<usize> = wholes().map(|whole| self.images[whole].camera).collect();
        let camera_of: BTreeMap<usize, usize> = cameras.iter().copied().zip(0..).collect();
        // For each observed point its observations; images and keypoints are in ascending order.
        let mut tracks: BTreeMap<PointId, Vec<Observation>> = BTreeMap::new();
        let mut images = Vec::with_capacity(region.of_images.len());
        for (image, whole) in (0_u32..).zip(wholes()) {
            let view = self.image(whole);
            let mut copy = view.to_model();
            copy.camera = camera_of[&copy.camera];
            for (keypoint, point) in (0_u32..).zip(&copy.point_of_keypoint) {
                if let Some(point) = point {
                    tracks.entry(*point).or_default().push(Observation { image, keypoint });
                }
            }
            images.push(copy);
        }
        let compressed = WholeMapSummary::of(self, tracks.keys().copied());
        let points = tracks.into_iter().map(|(id, track)| MapPoint {
            position: self.point(id),
            track,
            error: self.reprojection_error(id),
        });
        let mut model = MapModel {
            cameras: cameras.into_iter().map(|camera| self.cameras[camera]).collect(),
            images,
            points: points.collect(),
            settings: *self.settings(),
            profile: self.profile().clone(),
            self_test: self.self_test().cloned(),
            down: self.down(),
            is_metric: self.is_metric(),
            alignment: self.alignment(),
            compressed: Some(compressed),
            region: Some(region),
        };
        model.link_keypoints();
        Ok(model)
    }
}
