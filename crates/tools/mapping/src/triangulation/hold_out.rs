//! A map without some of its images: for tests that localize one of them, and for good.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_geometry::Point3;
use veiloc_map::{BuildSettings, HeldOut, HeldOutPoint, MapModel, Observation, PointEvidence, PointId};

use crate::input::options::for_images;
use crate::triangulation::scene::{Fallback, Scene};
use crate::triangulation::triangulate::{refine_inliers, triangulate};

/// Maximum number of neighbours that are left out with an image. With four, errors in a map of a few images for each
/// place (hololens-office) are several times those of queries.
const MAX_NEIGHBORS: usize = 2;

/// A map of less images for each neighbour would lose too many of its points.
const IMAGES_PER_NEIGHBOR: usize = 10;

/// A map from which images are left out, for tests that localize images of the map.
pub struct HoldOutMap<'a> {
    model: &'a MapModel,
    scene: Scene<'a>,
    settings: BuildSettings,
}

impl<'a> HoldOutMap<'a> {
    /// Prepares a consistent map.
    pub fn of(model: &'a MapModel) -> Self {
        let settings = for_images(&model.settings, model.images.len().saturating_sub(1));
        Self { model, scene: Scene::of(model, &settings), settings }
    }

    /// Returns the map without the images of these indices: each point that they observe is triangulated again from
    /// the other images, or removed if fewer images agree than a new point needs, or if the triangulation angle is too
    /// small.
    ///
    /// Other traces of the images remain: tracks of other images that they merged, and their share in the words of the
    /// vocabulary.
    pub fn without(&self, images: &BTreeSet<usize>) -> HeldOut {
        let seen: BTreeSet<PointId> = images
            .iter()
            .flat_map(|image| self.model.images[*image].point_of_keypoint.iter().flatten().copied())
            .collect();
        HeldOut {
            images: images.clone(),
            points: seen.into_iter().map(|id| (id, self.point_without(id, images))).collect(),
        }
    }

    /// Returns the image of this index and the two images that share most points with it, or fewer in a map of less
    /// than 20 images. A query is taken from another place than all images of the map: a test with an image whose
    /// neighbours remain gives smaller errors.
    pub fn with_neighbors(&self, image: usize) -> BTreeSet<usize> {
        let count = (self.model.images.len() / IMAGES_PER_NEIGHBOR).min(MAX_NEIGHBORS);
        let mut shared = vec![0_u32; self.model.images.len()];
        for id in self.model.images[image].point_of_keypoint.iter().flatten() {
            for node in &self.scene.points[id.index()].track {
                shared[node.0 as usize] += 1;
            }
        }
        shared[image] = 0;
        let mut order: Vec<usize> = (0..shared.len()).filter(|i| shared[*i] > 0).collect();
        order.sort_by_key(|i| (std::cmp::Reverse(shared[*i]), *i));
        order.into_iter().take(count).chain([image]).collect()
    }

    fn point_without(&self, id: PointId, images: &BTreeSet<usize>) -> Option<HeldOutPoint> {
        let mut point = self.scene.points[id.index()].clone();
        point.track.retain(|node| !images.contains(&(node.0 as usize)));
        let (nodes, observations) = self.scene.observations(&point.track);
        let min_observations = self.settings.min_track_length as usize;
        let angle = self.settings.min_triangulation_angle_deg;
        // Without this image the others may agree on another position.
        let found = refine_inliers(&observations, point.position, min_observations, angle)
            .or_else(|| triangulate(&observations, min_observations, angle))?;
        let agreeing = nodes.iter().zip(&found.agree).filter_map(|(node, agrees)| agrees.then_some(node));
        let track: Vec<Observation> =
            agreeing.map(|&(image, keypoint)| Observation { image, keypoint }).collect();
        Some(HeldOutPoint {
            position: Point3::from_vector(found.position),
            evidence: PointEvidence::Track(track),
        })
    }
}

/// Drops the images of these indices from a map, with its self-test. Points that they observe are triangulated again from the
/// other images, or removed if too few observations remain; all other points stay bit-identical.
pub(crate) fn drop_images(model: &mut MapModel, images: &BTreeSet<u32>) {
    let settings = model.settings;
    let staying: Vec<usize> = (0..model.images.len()).filter(|i| !images.contains(&(*i as u32))).collect();
    let mut scene = Scene::of(model, &settings);
    for point in &mut scene.points {
        let count = point.track.len();
        point.track.retain(|(image, _)| !images.contains(image));
        point.touched = point.track.len() < count;
    }
    scene.refine_touched(&settings, Fallback::Vanish);
    let points = scene.finish();
    model.points = points;
    model.self_test = None;

    let new_index: BTreeMap<u32, u32> = staying.iter().map(|i| *i as u32).zip(0..).collect();
    let mut index = 0;
    model.images.retain(|_| {
        index += 1;
        !images.contains(&(index - 1))
    });
    for point in &mut model.points {
        for Observation { image, .. } in &mut point.track {
            *image = new_index[image];
        }
    }
    drop_unused_cameras(model);
    model.link_keypoints();
}

fn drop_unused_cameras(model: &mut MapModel) {
    let used: BTreeSet<usize> = model.images.iter().map(|i| i.camera).collect();
    let new_index: BTreeMap<usize, usize> = used.iter().copied().zip(0..).collect();
    model.cameras = used.iter().map(|i| model.cameras[*i]).collect();
    for image in &mut model.images {
        image.camera = new_index[&image.camera];
    }
}
