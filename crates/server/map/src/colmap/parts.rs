//! The parts of a COLMAP model as read.

use std::collections::BTreeSet;

use veiloc_geometry::Intrinsics;

use super::records::{ColmapImage, ColmapPoint};
use super::rigs::ColmapRigs;
use crate::error::MapError;

/// The id of a camera, and the camera, or why it cannot be used.
pub(super) type ReadCamera = (u32, Result<Intrinsics, MapError>);

/// The parts of a model as read, before cross-checks.
#[derive(Default)]
pub(crate) struct Parts {
    pub(crate) cameras: Vec<(u32, Intrinsics)>,
    pub(crate) images: Vec<ColmapImage>,
    /// Cameras that have no model here or invalid parameters, and why.
    pub(crate) odd_cameras: Vec<(u32, MapError)>,
    /// What is odd in the images that were not read.
    pub(crate) odd_images: Vec<MapError>,
    pub(crate) points: Vec<ColmapPoint>,
    /// Rigs and frames, if the model has them.
    pub(crate) rigs: Option<ColmapRigs>,
    /// What was left out or changed, for people.
    pub(crate) remarks: Vec<String>,
}

impl Parts {
    /// Cameras as read, sorted into those that can be used and those that cannot.
    pub(super) fn sort_cameras(&mut self, cameras: Vec<ReadCamera>) {
        for (id, camera) in cameras {
            match camera {
                Ok(camera) => self.cameras.push((id, camera)),
                Err(error) => self.odd_cameras.push((id, error)),
            }
        }
    }

    /// Images as read, likewise.
    pub(super) fn sort_images(&mut self, images: Vec<Result<ColmapImage, MapError>>) {
        for image in images {
            match image {
                Ok(image) => self.images.push(image),
                Err(error) => self.odd_images.push(error),
            }
        }
    }

    /// Leaves out images whose camera cannot be used, and remarks on all that are left out. A camera that no image has does
    /// not matter.
    ///
    /// # Errors
    /// No image is left.
    pub(super) fn leave_out_odd(&mut self) -> Result<(), MapError> {
        let before = self.images.len() + self.odd_images.len();
        let mut causes = std::mem::take(&mut self.odd_images);
        let mut unused = Vec::new();
        for (id, error) in std::mem::take(&mut self.odd_cameras) {
            let count = self.images.len();
            self.images.retain(|image| image.camera_id != id);
            if self.images.len() < count { causes.push(error) } else { unused.push(error) }
        }
        if self.images.is_empty() {
            return causes.into_iter().chain(unused).next().map_or(Ok(()), Err);
        }
        if causes.is_empty() {
            return Ok(());
        }
        let (left_out, first) = (before - self.images.len(), &causes[0]);
        self.remarks.push(format!("{left_out} of {before} images are left out; the first cause is {first}"));
        let ids: BTreeSet<u32> = self.images.iter().map(|image| image.id).collect();
        for point in &mut self.points {
            point.track.retain(|(image, _)| ids.contains(image));
        }
        Ok(())
    }

    /// Removes the references from 2D points to points, for a model without points.
    pub(crate) fn forget_points(&mut self) {
        self.points.clear();
        self.images.iter_mut().flat_map(|i| &mut i.points2d).for_each(|p| p.point = None);
    }
}

impl Parts {
    /// Gives the images the poses of rigs and frames, and remarks on images whose own pose was another one.
    ///
    /// # Errors
    /// What is inconsistent in the rigs and frames.
    pub(super) fn pose_by(&mut self, rigs: ColmapRigs) -> Result<(), String> {
        rigs.check()?;
        let poses = rigs.poses();
        let (mut overruled, mut without) = (0_usize, 0_usize);
        let (mut farthest, mut widest) = (0.0_f64, 0.0_f64);
        for image in &mut self.images {
            let Some(pose) = poses.get(&image.id.into()) else {
                without += 1;
                continue;
            };
            let distance = pose.translation_error(&image.cam_from_world);
            let angle = pose.rotation_error_degrees(&image.cam_from_world);
            let size = 1.0 + pose.translation().norm();
            if distance > SAME_POSITION * size || angle > SAME_ROTATION_DEG {
                overruled += 1;
                (farthest, widest) = (farthest.max(distance), widest.max(angle));
            }
            image.cam_from_world = *pose;
        }
        let of = self.images.len();
        if overruled > 0 {
            self.remarks.push(format!(
                "{overruled} of {of} poses in images differ from those of rigs and frames, by up to {farthest:.3} map units \
                 and {widest:.2}\u{b0}; the poses of rigs and frames are used, as COLMAP does"
            ));
        }
        if without > 0 && !poses.is_empty() {
            self.remarks.push(format!(
                "{without} of {of} images have no frame, or a camera without a pose on its rig; their poses in images are \
                 used"
            ));
        }
        self.rigs = Some(rigs);
        Ok(())
    }
}

/// Poses that differ by less are equal: text files have at least six digits. Part of the distance from the origin.
const SAME_POSITION: f64 = 1e-5;
/// The same for rotations, degrees.
const SAME_ROTATION_DEG: f64 = 1e-3;
