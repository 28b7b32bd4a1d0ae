//! A map without one of its images, for each image in turn.

use std::collections::BTreeSet;

use veiloc_geometry::Point3;
use veiloc_map::{
    BuildSettings, LeaveOneOut, LeaveOneOutPoint, MapModel, Observation, PointEvidence, PointId,
};

use crate::options::for_images;
use crate::scene::Scene;
use crate::triangulation::{refine_inliers, triangulate};

/// A map from which one image at a time is left out, for tests that localize images of the map.
pub struct LeaveOneOutMap<'a> {
    model: &'a MapModel,
    scene: Scene<'a>,
    settings: BuildSettings,
}

impl<'a> LeaveOneOutMap<'a> {
    /// Prepares a consistent map.
    pub fn of(model: &'a MapModel) -> Self {
        let settings = for_images(&model.settings, model.images.len().saturating_sub(1));
        Self { model, scene: Scene::of(model, &settings), settings }
    }

    /// Returns the map without the image of this index: each point that it observes is triangulated again from the
    /// other images, or removed if fewer images agree than a new point needs, or if the triangulation angle is too
    /// small.
    ///
    /// Other traces of the image remain: tracks of other images that it merged, and its share in the words of the
    /// vocabulary.
    pub fn without(&self, image: usize) -> LeaveOneOut {
        let seen: BTreeSet<PointId> =
            self.model.images[image].point_of_keypoint.iter().flatten().copied().collect();
        LeaveOneOut {
            image,
            points: seen.into_iter().map(|id| (id, self.point_without(id, image))).collect(),
        }
    }

    fn point_without(&self, id: PointId, image: usize) -> Option<LeaveOneOutPoint> {
        let mut point = self.scene.points[id.index()].clone();
        point.track.retain(|node| node.0 as usize != image);
        let (nodes, sights) = self.scene.sights(&point.track);
        let min_observations = self.settings.min_track_length as usize;
        let angle = self.settings.min_triangulation_angle_deg;
        // Without this image the others may agree on another position.
        let found = refine_inliers(&sights, point.position, min_observations, angle)
            .or_else(|| triangulate(&sights, min_observations, angle))?;
        let agreeing = nodes.iter().zip(&found.agree).filter_map(|(node, agrees)| agrees.then_some(node));
        let track: Vec<Observation> =
            agreeing.map(|&(image, keypoint)| Observation { image, keypoint }).collect();
        Some(LeaveOneOutPoint {
            position: Point3::from_vector(found.position),
            evidence: PointEvidence::Track(track),
        })
    }
}
