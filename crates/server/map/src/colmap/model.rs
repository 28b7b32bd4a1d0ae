//! A consistent COLMAP model in memory.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use veiloc_geometry::Intrinsics;

use super::parts::Parts;
use super::records::{ColmapImage, ColmapPoint};
use super::rigs::ColmapRigs;
use crate::error::{MapError, ModelRecord};
use crate::model::{is_name, is_rigid};

/// A COLMAP model with valid references: every image has its camera, names and ids are unique, observations of images
/// and points agree, every number is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapModel {
    cameras: BTreeMap<u32, Intrinsics>,
    images: Vec<ColmapImage>,
    points: Vec<ColmapPoint>,
    /// Index in `images` by name.
    by_name: BTreeMap<String, usize>,
    /// Index in `images` by id.
    by_id: BTreeMap<u32, usize>,
    rigs: Option<ColmapRigs>,
    remarks: Vec<String>,
}

impl ColmapModel {
    /// Checks and combines the parts.
    ///
    /// # Errors
    /// [`MapError::ColmapRecord`] with the record that does not fit.
    pub fn new(
        cameras: Vec<(u32, Intrinsics)>,
        images: Vec<ColmapImage>,
        points: Vec<ColmapPoint>,
    ) -> Result<Self, MapError> {
        Self::checked(Parts { cameras, images, points, ..Parts::default() }, None)
    }

    pub(crate) fn checked(mut parts: Parts, dir: Option<&Path>) -> Result<Self, MapError> {
        let refuse = |record: ModelRecord, reason: String| MapError::ColmapRecord {
            dir: dir.map(Path::to_owned),
            record,
            reason,
        };
        let mut cameras = BTreeMap::new();
        for (id, camera) in std::mem::take(&mut parts.cameras) {
            if cameras.insert(id, camera).is_some() {
                return Err(refuse(
                    ModelRecord::Camera(id),
                    "is defined twice; remove one of them".to_owned(),
                ));
            }
        }
        let (mut by_name, mut by_id) = (BTreeMap::new(), BTreeMap::new());
        for (index, image) in parts.images.iter().enumerate() {
            let this = || ModelRecord::Image(image.name.clone());
            if !is_name(&image.name) {
                return Err(refuse(
                    ModelRecord::ImageId(image.id),
                    "has no usable file name; give it one".to_owned(),
                ));
            }
            if !cameras.contains_key(&image.camera_id) {
                let reason =
                    format!("has camera {}, which the model does not define; add it", image.camera_id);
                return Err(refuse(this(), reason));
            }
            if !is_rigid(&image.cam_from_world) {
                return Err(refuse(
                    this(),
                    "has a pose that is not finite or turns by no rotation; remove the image or give it a pose"
                        .into(),
                ));
            }
            if let Some(i) = image.points2d.iter().position(|p| !p.pixel.is_finite()) {
                return Err(refuse(this(), format!("has a 2D point {i} that is not finite")));
            }
            if by_name.insert(image.name.clone(), index).is_some() {
                return Err(refuse(this(), "appears twice; keep one of them".to_owned()));
            }
            if by_id.insert(image.id, index).is_some() {
                return Err(refuse(
                    ModelRecord::ImageId(image.id),
                    "appears twice; give each image its own id".to_owned(),
                ));
            }
        }
        let Parts { images, points, rigs, remarks, .. } = parts;
        let model = Self { cameras, images, points, by_name, by_id, rigs, remarks };
        model.check_tracks().map_err(|(record, reason)| refuse(record, reason))?;
        Ok(model)
    }

    /// Checks that images and points have the same observations.
    fn check_tracks(&self) -> Result<(), (ModelRecord, String)> {
        let mut ids = BTreeSet::new();
        let mut observations = 0_usize;
        for point in &self.points {
            let refuse = |reason: String| Err((ModelRecord::Point(point.id), reason));
            if !ids.insert(point.id) {
                return refuse("appears twice; give each point its own id".to_owned());
            }
            if !point.position.is_finite() || point.error.is_nan() {
                return refuse("has a position or error that is not a number; remove it".to_owned());
            }
            let mut seen = BTreeSet::new();
            for &(image, keypoint) in &point.track {
                let Some(image) = self.image_by_id(image) else {
                    return refuse(format!("is seen by image {image}, which the model does not have"));
                };
                let Some(keypoint_2d) = image.points2d.get(keypoint as usize) else {
                    let count = image.points2d.len();
                    return refuse(format!(
                        "is seen by 2D point {keypoint} of {:?}, which has only {count}",
                        image.name
                    ));
                };
                if keypoint_2d.point != Some(point.id) || !seen.insert((image.id, keypoint)) {
                    return refuse(format!(
                        "is seen by 2D point {keypoint} of {:?} only according to points3D, not to images; export the \
                         model again",
                        image.name
                    ));
                }
                observations += 1;
            }
        }
        // All tracks are valid; if more keypoints have points, some of these references are dangling.
        let linked = self.images.iter().flat_map(|i| &i.points2d).filter(|p| p.point.is_some()).count();
        if linked == observations {
            return Ok(());
        }
        let tracks: BTreeSet<(u32, u32)> = self.points.iter().flat_map(|p| p.track.iter().copied()).collect();
        for image in &self.images {
            for (index, keypoint) in image.points2d.iter().enumerate() {
                let Some(point) = keypoint.point else { continue };
                if !tracks.contains(&(image.id, index as u32)) {
                    let reason = format!(
                        "has 2D point {index} that sees point {point}, which points3D does not say; export the model \
                         again"
                    );
                    return Err((ModelRecord::Image(image.name.clone()), reason));
                }
            }
        }
        Ok(())
    }

    /// Cameras by COLMAP's id.
    pub const fn cameras(&self) -> &BTreeMap<u32, Intrinsics> {
        &self.cameras
    }

    /// Images in the model's order.
    pub fn images(&self) -> &[ColmapImage] {
        &self.images
    }

    /// Points in the model's order.
    pub fn points(&self) -> &[ColmapPoint] {
        &self.points
    }

    /// The rigs and frames that were read; `None` for a model without them.
    pub const fn rigs(&self) -> Option<&ColmapRigs> {
        self.rigs.as_ref()
    }

    /// The rigs and frames of the model, or a rig for each camera and a frame for each image.
    pub(super) fn rigs_to_write(&self) -> Cow<'_, ColmapRigs> {
        match &self.rigs {
            Some(rigs) => Cow::Borrowed(rigs),
            None => Cow::Owned(ColmapRigs::trivial(self.cameras.keys().copied(), &self.images)),
        }
    }

    /// What reading left out or changed, for people; empty for a model that was taken as it is.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Names of all images, in the model's order.
    pub fn image_names(&self) -> Vec<String> {
        self.images.iter().map(|i| i.name.clone()).collect()
    }

    /// The image with this name.
    pub fn image_by_name(&self, name: &str) -> Option<&ColmapImage> {
        self.by_name.get(name).map(|&i| &self.images[i])
    }

    /// The image with this COLMAP id.
    pub fn image_by_id(&self, id: u32) -> Option<&ColmapImage> {
        self.by_id.get(&id).map(|&i| &self.images[i])
    }

    /// The camera of an image of this model.
    pub fn camera_of(&self, image: &ColmapImage) -> &Intrinsics {
        self.cameras
            .get(&image.camera_id)
            .expect("an image of this model has its camera in it, checked at construction")
    }
}
