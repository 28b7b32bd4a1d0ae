//! Leaves out points and observations on which `images` and `points3D` do not agree.
//!
//! COLMAP itself writes such models: its triangulator leaves 2D points that name a point which it has removed. Poses and
//! cameras do not depend on them.

use std::collections::{BTreeMap, BTreeSet};

use super::parts::Parts;
use super::records::ColmapPoint2d;

impl Parts {
    /// Keeps the observations that both files have, and points with a position and an id of their own.
    pub(super) fn reconcile(&mut self) {
        let before = self.points.len();
        let mut ids = BTreeSet::new();
        self.points.retain(|point| point.position.is_finite() && ids.insert(point.id));
        let invalid = before - self.points.len();
        for point in self.points.iter_mut().filter(|point| point.error.is_nan()) {
            point.error = NOT_COMPUTED;
        }

        // The first image counts where an id occurs twice; the model is then refused for that.
        let mut points_of: BTreeMap<u32, &mut [ColmapPoint2d]> = BTreeMap::new();
        for image in &mut self.images {
            points_of.entry(image.id).or_insert(&mut image.points2d);
        }
        let linked = points_of.values().flat_map(|all| all.iter()).filter(|p| p.point.is_some()).count();
        let mut agreed = BTreeSet::new();
        let mut only_in_points = 0;
        for point in &mut self.points {
            point.track.retain(|&(image, keypoint)| {
                let seen = points_of.get(&image).and_then(|all| all.get(keypoint as usize));
                let agrees = seen.is_some_and(|seen| seen.point == Some(point.id));
                let kept = agrees && agreed.insert((image, keypoint));
                only_in_points += usize::from(!kept);
                kept
            });
        }
        let only_in_images = linked - agreed.len();
        for (image, points2d) in &mut points_of {
            for (keypoint, seen) in (0..).zip(points2d.iter_mut()) {
                seen.point = seen.point.filter(|_| agreed.contains(&(*image, keypoint)));
            }
        }
        if invalid > 0 {
            self.remarks.push(format!(
                "points3D: {invalid} of {before} points have no finite position or the id of another point, and are \
                 left out"
            ));
        }
        if only_in_images + only_in_points > 0 {
            self.remarks.push(format!(
                "{} observations are left out, because images and points3D do not agree on them ({only_in_images} are \
                 only in images, {only_in_points} only in points3D; {} are in both)",
                only_in_images + only_in_points,
                agreed.len()
            ));
        }
    }
}

/// COLMAP's value of an error that was not computed.
const NOT_COMPUTED: f64 = -1.0;
