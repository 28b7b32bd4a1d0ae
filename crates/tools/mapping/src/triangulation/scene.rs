//! A map under construction: views, and points whose tracks change.

use rayon::prelude::*;
use veiloc_descriptor::DescriptorView;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_map::{BuildSettings, MapModel, MapPoint, Observation, PosedImage};

use crate::input::cache::ExtractedFeatures;
use crate::input::options::pixels_at;
use crate::triangulation::matching::Edge;
use crate::triangulation::tracks::{Node, build_tracks};
use crate::triangulation::triangulate::{ViewObservation, refine_inliers, triangulate};
use crate::triangulation::view::View;

/// A point that may still change.
#[derive(Debug, Clone)]
pub(crate) struct WorkPoint {
    pub(crate) position: Vector3<f64>,
    /// Ascending; empty if the point was removed.
    pub(crate) track: Vec<Node>,
    /// Whether it is changed or new.
    pub(crate) touched: bool,
}

impl WorkPoint {
    pub(crate) fn sees(&self, image: u32) -> bool {
        self.track.iter().any(|n| n.0 == image)
    }

    pub(crate) fn insert(&mut self, node: Node) {
        let at = self.track.partition_point(|n| *n < node);
        self.track.insert(at, node);
        self.touched = true;
    }
}

/// Images and points of a map that is being built or changed.
pub(crate) struct Scene<'a> {
    pub(crate) views: Vec<View>,
    /// `[images][N]`
    pub(crate) keypoints: Vec<&'a [[f32; 2]]>,
    /// `[images]`
    pub(crate) descriptors: Vec<DescriptorView<'a>>,
    pub(crate) points: Vec<WorkPoint>,
    /// `[images][N]`, index of the point that each keypoint observes.
    pub(crate) point_of: Vec<Vec<Option<u32>>>,
    /// The original points; `points` begins with them.
    before: &'a [MapPoint],
}

/// Treatment of an existing point that has too few agreeing observations after a change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fallback {
    /// Restore the original point: the new observations were wrong.
    Restore,
    /// Remove the point: it lost observations.
    Vanish,
}

impl<'a> Scene<'a> {
    /// Creates a scene of images without points.
    pub(crate) fn of_features(
        images: &[&PosedImage],
        features: &'a [ExtractedFeatures],
        settings: &BuildSettings,
    ) -> Self {
        let views = images
            .par_iter()
            .zip(features)
            .map(|(image, found)| view_of(image.camera, image.cam_from_world, &found.keypoints, settings));
        Self {
            views: views.collect(),
            keypoints: features.iter().map(|found| found.keypoints.as_slice()).collect(),
            descriptors: features.iter().map(|found| found.descriptors.view()).collect(),
            points: Vec::new(),
            point_of: features.iter().map(|found| vec![None; found.keypoints.len()]).collect(),
            before: &[],
        }
    }

    /// Creates a scene of the images and points of a model, with no point touched.
    pub(crate) fn of(model: &'a MapModel, settings: &BuildSettings) -> Self {
        let views = model.images.par_iter().map(|image| {
            view_of(model.cameras[image.camera], image.cam_from_world, &image.keypoints, settings)
        });
        let points = model.points.iter().map(|p| WorkPoint {
            position: p.position.coords,
            track: p.track.iter().map(|o| (o.image, o.keypoint)).collect(),
            touched: false,
        });
        let mut scene = Self {
            views: views.collect(),
            keypoints: model.images.iter().map(|i| i.keypoints.as_slice()).collect(),
            descriptors: model.images.iter().map(|i| i.descriptors.view()).collect(),
            points: points.collect(),
            point_of: model.images.iter().map(|i| vec![None; i.keypoints.len()]).collect(),
            before: &model.points,
        };
        for index in 0..scene.points.len() {
            for (image, keypoint) in scene.points[index].track.clone() {
                scene.point_of[image as usize][keypoint as usize] = Some(index as u32);
            }
        }
        scene
    }

    pub(crate) fn point_at(&self, node: Node) -> Option<u32> {
        self.point_of[node.0 as usize][node.1 as usize]
    }

    pub(crate) fn assign(&mut self, node: Node, point: Option<u32>) {
        self.point_of[node.0 as usize][node.1 as usize] = point;
    }

    pub(crate) fn observation(&self, node: Node) -> Option<ViewObservation<'_>> {
        let view = &self.views[node.0 as usize];
        Some(ViewObservation { view, plane: view.plane[node.1 as usize]? })
    }

    /// Returns the keypoints that have a ray, with their observations.
    pub(crate) fn observations(&self, track: &[Node]) -> (Vec<Node>, Vec<ViewObservation<'_>>) {
        track.iter().filter_map(|n| Some((*n, self.observation(*n)?))).unzip()
    }

    /// Builds tracks from the edges between keypoints without a point, and triangulates the tracks.
    pub(crate) fn new_points(&mut self, edges: &[Edge], settings: &BuildSettings) {
        let free = edges.iter().filter(|e| self.point_at(e.a).is_none() && self.point_at(e.b).is_none());
        let tracks = build_tracks(free.map(|e| (e.a, e.b)));
        let points: Vec<Vec<WorkPoint>> =
            tracks.par_iter().map(|t| self.points_of_track(t, settings)).collect();
        for point in points.into_iter().flatten() {
            self.push(point);
        }
    }

    /// A wrong match merges the tracks of two points: observations that disagree with the first point may give a second
    /// one.
    fn points_of_track(&self, track: &[Node], settings: &BuildSettings) -> Vec<WorkPoint> {
        let (mut nodes, mut observations) = self.observations(track);
        let mut points = Vec::new();
        let mut min_observations = settings.min_track_length as usize;
        while nodes.len() >= min_observations {
            let Some(found) =
                triangulate(&observations, min_observations, settings.min_triangulation_angle_deg)
            else {
                break;
            };
            let mut agree = found.agree.iter();
            let (inside, outside): (Vec<Node>, Vec<Node>) =
                nodes.iter().partition(|_| *agree.next().expect("one flag per observation"));
            points.push(WorkPoint { position: found.position, track: inside, touched: true });
            (nodes, observations) = self.observations(&outside);
            // Two remaining observations agree too easily.
            min_observations = (settings.min_track_length as usize).max(3);
        }
        points
    }

    fn push(&mut self, point: WorkPoint) {
        let index = Some(self.points.len() as u32);
        for node in &point.track {
            self.assign(*node, index);
        }
        self.points.push(point);
    }

    /// Refines every touched point on its track; observations that no longer agree are removed, new points without
    /// enough observations or angle are dropped, and old ones are treated according to `fallback`.
    pub(crate) fn refine_touched(&mut self, settings: &BuildSettings, fallback: Fallback) {
        let settled: Vec<Option<(Vector3<f64>, Vec<Node>)>> = self
            .points
            .par_iter()
            .enumerate()
            .map(|(index, point)| {
                if !point.touched || point.track.is_empty() {
                    return None;
                }
                let (nodes, observations) = self.observations(&point.track);
                // An existing point needs fewer observations than a new one.
                let min_observations =
                    if index < self.before.len() { 2 } else { settings.min_track_length as usize };
                let found = refine_inliers(
                    &observations,
                    point.position,
                    min_observations,
                    settings.min_triangulation_angle_deg,
                );
                Some(found.map_or_else(
                    || (point.position, Vec::new()),
                    |f| {
                        (
                            f.position,
                            nodes.into_iter().zip(f.agree).filter_map(|(n, a)| a.then_some(n)).collect(),
                        )
                    },
                ))
            })
            .collect();
        for (index, (position, track)) in settled.into_iter().enumerate().filter_map(|(i, s)| Some((i, s?))) {
            for node in std::mem::replace(&mut self.points[index].track, track) {
                self.assign(node, None);
            }
            self.points[index].position = position;
            if self.points[index].track.is_empty() && fallback == Fallback::Restore {
                self.restore(index);
            }
            for node in self.points[index].track.clone() {
                self.assign(node, Some(index as u32));
            }
        }
    }

    /// Restores a point, unless another point has taken one of its keypoints in the meantime.
    fn restore(&mut self, index: usize) {
        let Some(old) = self.before.get(index) else { return };
        let track: Vec<Node> = old.track.iter().map(|o| (o.image, o.keypoint)).collect();
        if track.iter().all(|n| self.point_at(*n).is_none()) {
            self.points[index] = WorkPoint { position: old.position.coords, track, touched: false };
        }
    }

    /// Returns the points of the map, in order: untouched ones unchanged, the others as refined.
    pub(crate) fn finish(&self) -> Vec<MapPoint> {
        let finished: Vec<Option<MapPoint>> = self
            .points
            .par_iter()
            .enumerate()
            .map(|(index, point)| match self.before.get(index) {
                Some(old) if !point.touched => Some(old.clone()),
                _ if point.track.is_empty() => None,
                _ => Some(self.finished(point)),
            })
            .collect();
        finished.into_iter().flatten().collect()
    }

    fn finished(&self, point: &WorkPoint) -> MapPoint {
        let errors = point.track.iter().filter_map(|(image, keypoint)| {
            let pixel = self.keypoints[*image as usize][*keypoint as usize];
            self.views[*image as usize].error_in_image(pixel, &point.position)
        });
        MapPoint {
            position: Point3::from_vector(point.position),
            track: point.track.iter().map(|&(image, keypoint)| Observation { image, keypoint }).collect(),
            error: errors.sum::<f64>() / point.track.len().max(1) as f64,
        }
    }
}

/// Returns a view with thresholds for its image size.
fn view_of(
    camera: Intrinsics,
    cam_from_world: CameraFromWorld,
    keypoints: &[[f32; 2]],
    settings: &BuildSettings,
) -> View {
    let pixels = |threshold| pixels_at(threshold, camera.width, camera.height);
    let (error, epipolar) =
        (pixels(settings.max_reprojection_error_px), pixels(settings.max_epipolar_error_px));
    View::new(camera, cam_from_world, keypoints, error, epipolar)
}
