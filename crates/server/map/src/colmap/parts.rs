//! The parts of a COLMAP model as read.

use veiloc_geometry::Intrinsics;

use super::records::{ColmapImage, ColmapPoint};
use super::rigs::ColmapRigs;

/// The parts of a model as read, before cross-checks.
#[derive(Default)]
pub(crate) struct Parts {
    pub(crate) cameras: Vec<(u32, Intrinsics)>,
    pub(crate) images: Vec<ColmapImage>,
    pub(crate) points: Vec<ColmapPoint>,
    /// Rigs and frames, if the model has them.
    pub(crate) rigs: Option<ColmapRigs>,
    /// What was left out or changed, for people.
    pub(crate) remarks: Vec<String>,
}

impl Parts {
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
