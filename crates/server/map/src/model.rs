//! A map as an owned value, which mapping builds, extends and shrinks.

use std::collections::BTreeSet;

use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Matrix3;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_protocol::Profile;

use crate::alignment::AlignmentAccuracy;
use crate::compressed::WholeMapSummary;
use crate::error::{MapError, ModelRecord};
use crate::gravity::GravityDirection;
use crate::region::Region;
use crate::self_test::SelfTest;
use crate::settings::BuildSettings;

/// A point of a map: its index. Ids of different maps, or of a map before and after a change, are not related.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PointId(pub u32);

impl PointId {
    /// The index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// An observation of a point by a keypoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Observation {
    /// Index of the image.
    pub image: u32,
    /// Index of the keypoint in that image.
    pub keypoint: u32,
}

/// An image of the map. All of its keypoints are kept, also those without a point, because images added later may
/// need them. (A compressed map keeps only some of those with a point.)
#[derive(Debug, Clone, PartialEq)]
pub struct MapImage {
    /// File name, relative to the folder of the images; unique in the map.
    pub name: String,
    /// Index of its camera.
    pub camera: usize,
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
    /// `[N]`, pixels `[u, v]` in the original (distorted) image.
    pub keypoints: Vec<[f32; 2]>,
    /// `[N, dim]`
    pub descriptors: Descriptors,
    /// Global descriptor of all its descriptors.
    pub global: GlobalDescriptor,
    /// `[N]`, the point that each keypoint observes.
    pub point_of_keypoint: Vec<Option<PointId>>,
}

/// A triangulated point.
#[derive(Debug, Clone, PartialEq)]
pub struct MapPoint {
    /// Position, map units.
    pub position: Point3<World>,
    /// Observations, in ascending order, at least one.
    pub track: Vec<Observation>,
    /// Mean reprojection error over the track, pixels of the images.
    pub error: f64,
}

/// A map.
///
/// The parts may be modified freely; [`Self::validate`] checks their consistency.
#[derive(Debug, Clone, PartialEq)]
pub struct MapModel {
    /// Cameras; images refer to them by index.
    pub cameras: Vec<Intrinsics>,
    /// Images; observations refer to them by index.
    pub images: Vec<MapImage>,
    /// Points, by [`PointId`].
    pub points: Vec<MapPoint>,
    /// Settings of the build, also used for images that are added later.
    pub settings: BuildSettings,
    /// The profile with which a device seals queries for this map.
    pub profile: Profile,
    /// The self-test. It becomes invalid when images or points change, so code that changes them must remove it.
    pub self_test: Option<SelfTest>,
    /// The direction of gravity, if known; independent of images.
    pub down: Option<GravityDirection>,
    /// Whether map units are metres; false if not known, as of structure from motion.
    pub is_metric: bool,
    /// How well the coordinate frame is known, if the map was aligned to known positions.
    pub alignment: Option<AlignmentAccuracy>,
    /// Data about the whole map, in a compressed map; images can be neither added to it nor removed.
    pub compressed: Option<WholeMapSummary>,
    /// The part of a larger map, in a region; a region is also [`Self::compressed`], with the numbers of the larger
    /// map.
    pub region: Option<Region>,
}

impl MapModel {
    /// A map without images.
    pub const fn empty(profile: Profile, settings: BuildSettings) -> Self {
        Self {
            cameras: Vec::new(),
            images: Vec::new(),
            points: Vec::new(),
            settings,
            profile,
            self_test: None,
            down: None,
            is_metric: false,
            alignment: None,
            compressed: None,
            region: None,
        }
    }

    /// Index of the image with this name.
    pub fn image_index(&self, name: &str) -> Option<usize> {
        self.images.iter().position(|i| i.name == name)
    }

    /// Number of observations of all points.
    pub fn observation_count(&self) -> usize {
        self.points.iter().map(|p| p.track.len()).sum()
    }

    /// Observations per point; 0 without points.
    pub fn mean_track_length(&self) -> f64 {
        self.observation_count() as f64 / self.points.len().max(1) as f64
    }

    /// Mean reprojection error over all observations, pixels; 0 without points.
    pub fn mean_reprojection_error(&self) -> f64 {
        let sum: f64 = self.points.iter().map(|p| p.error * p.track.len() as f64).sum();
        sum / self.observation_count().max(1) as f64
    }

    /// Sets [`MapImage::point_of_keypoint`] of all images from the tracks, and clears previous values.
    ///
    /// Observations of missing images or keypoints are ignored here and found by [`Self::validate`].
    pub fn link_keypoints(&mut self) {
        for image in &mut self.images {
            image.point_of_keypoint.clear();
            image.point_of_keypoint.resize(image.keypoints.len(), None);
        }
        for (id, point) in (0_u32..).zip(&self.points) {
            for observation in &point.track {
                let image = self.images.get_mut(observation.image as usize);
                let slot = image.and_then(|i| i.point_of_keypoint.get_mut(observation.keypoint as usize));
                if let Some(slot) = slot {
                    *slot = Some(PointId(id));
                }
            }
        }
    }

    /// Checks consistency: indices in range, numbers finite, names unique, arrays of one image of equal length,
    /// tracks and keypoints in agreement.
    ///
    /// # Errors
    /// [`MapError::Model`] with the inconsistent part.
    pub fn validate(&self) -> Result<(), MapError> {
        let refuse = |record: ModelRecord, reason: String| Err(MapError::Model { record, reason });
        if let Err(error) = self.settings.check() {
            return refuse(ModelRecord::Map, format!("has invalid build settings: {error}"));
        }
        if let Some(Err(reason)) = self.self_test.as_ref().map(SelfTest::check) {
            return refuse(ModelRecord::Map, format!("has an invalid self-test: {reason}"));
        }
        let lengths = || self.points.iter().map(|p| p.track.len());
        if let Some(Err(reason)) = self.compressed.as_ref().map(|c| c.check(lengths())) {
            return refuse(ModelRecord::Map, reason);
        }
        let has_summaries = self.compressed.is_some();
        if let Some(Err(reason)) = self.region.as_ref().map(|r| r.check(self.images.len(), has_summaries)) {
            return refuse(ModelRecord::Map, reason);
        }
        let many = [self.cameras.len(), self.images.len(), self.points.len()];
        if many.iter().any(|n| *n >= u32::MAX as usize) {
            return refuse(ModelRecord::Map, "has more parts than 32-bit numbers can count".to_owned());
        }
        let mut names = BTreeSet::new();
        for image in &self.images {
            if let Err(reason) = self.check_image(image) {
                return refuse(ModelRecord::Image(image.name.clone()), reason);
            }
            if !names.insert(&image.name) {
                return refuse(ModelRecord::Image(image.name.clone()), "appears twice".to_owned());
            }
        }
        let mut observations = 0;
        for (id, point) in (0_u32..).zip(&self.points) {
            if let Err(reason) = self.check_point(PointId(id), point) {
                return refuse(ModelRecord::Point(id.into()), reason);
            }
            observations += point.track.len();
        }
        let linked = self.images.iter().flat_map(|i| &i.point_of_keypoint).filter(|p| p.is_some()).count();
        if linked != observations {
            let reason =
                format!("has {linked} keypoints that see points, but tracks of {observations} observations");
            return refuse(ModelRecord::Map, reason);
        }
        Ok(())
    }

    fn check_image(&self, image: &MapImage) -> Result<(), String> {
        let count = image.keypoints.len();
        let global = self.profile.global_model();
        if !is_name(&image.name) {
            return Err("has no usable file name".to_owned());
        }
        if image.camera >= self.cameras.len() {
            return Err(format!("has camera {} of {}", image.camera, self.cameras.len()));
        }
        if !is_rigid(&image.cam_from_world) {
            return Err("has a pose that is not finite or turns by no rotation".to_owned());
        }
        if image.descriptors.len() != count || image.point_of_keypoint.len() != count {
            return Err(format!(
                "has {count} keypoints, {} descriptors and {} links to points",
                image.descriptors.len(),
                image.point_of_keypoint.len()
            ));
        }
        if image.descriptors.kind() != self.profile.descriptor_kind() {
            return Err("has descriptors of another kind than the profile".to_owned());
        }
        if image.global.len() != global.global_len() {
            return Err(format!(
                "has a global descriptor of {} codes, the profile's has {}",
                image.global.len(),
                global.global_len()
            ));
        }
        if !image.keypoints.iter().flatten().all(|c| c.is_finite()) {
            return Err("has a keypoint that is not finite".to_owned());
        }
        Ok(())
    }

    fn check_point(&self, id: PointId, point: &MapPoint) -> Result<(), String> {
        if !point.position.is_finite() || !point.error.is_finite() {
            return Err("has a position or error that is not finite".to_owned());
        }
        if point.track.is_empty() {
            return Err("is seen by no image".to_owned());
        }
        if !point.track.is_sorted_by(|a, b| a < b) {
            return Err("has a track that is not in rising order".to_owned());
        }
        for o in &point.track {
            let links = self.images.get(o.image as usize).map(|i| &i.point_of_keypoint);
            if links.and_then(|l| l.get(o.keypoint as usize)) != Some(&Some(id)) {
                return Err(format!(
                    "is seen by keypoint {} of image {}, which does not refer to it",
                    o.keypoint, o.image
                ));
            }
        }
        Ok(())
    }
}

/// Not empty, and without characters that would break a list of names.
pub(crate) fn is_name(name: &str) -> bool {
    !name.is_empty() && !name.contains(['\0', '\n', '\r'])
}

/// Finite, with a rotation up to rounding.
pub(crate) fn is_rigid(pose: &CameraFromWorld) -> bool {
    let r = pose.rotation().matrix();
    pose.is_finite() && (r * r.transpose() - Matrix3::identity()).norm() < 1e-6 && r.determinant() > 0.0
}
