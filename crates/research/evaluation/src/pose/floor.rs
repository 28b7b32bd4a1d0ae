//! The floor: least squares from the true pose on the truly right matches, below which no estimator can be expected.

use veiloc_geometry::{CameraFromWorld, Pixel, PlanePoint};
use veiloc_pose::{Correspondences, PoseProblem};

/// How near a map point must project to its keypoint for a match to be truly right, pixels: the paper's inlier threshold
/// for images of 640 x 480.
pub const ORACLE_RADIUS_PX: f64 = 4.0;

/// A candidate line this far from its keypoint is the wrong one of two: dither and quantization move it by less.
const OFF_LINE_PX: f64 = 1.0;

/// Which correspondences are truly right, `[N]`: the map point projects within `radius_px` of the keypoint under the
/// true pose. Of two candidate lines of one keypoint, only the one through it can be.
///
/// `keypoints[k]` is where keypoint `k` of the problem truly is, in the image of the problem's camera.
pub fn truly_right(
    problem: &PoseProblem,
    truth: &CameraFromWorld,
    keypoints: &[Pixel],
    radius_px: f64,
) -> Vec<bool> {
    let near = |i: usize, keypoint: Pixel| {
        PlanePoint::from_camera_point(&truth.transform(&problem.points[i]))
            .is_some_and(|p| problem.camera.project(p).distance(&keypoint) <= radius_px)
    };
    (0..problem.points.len())
        .map(|i| {
            let keypoint = keypoints[problem.keypoints[i]];
            runs_through(problem, i, keypoint) && near(i, keypoint)
        })
        .collect()
}

/// Whether the line of correspondence `i` runs through its keypoint: false for the wrong one of two candidate lines.
pub(crate) fn runs_through(problem: &PoseProblem, i: usize, keypoint: Pixel) -> bool {
    match &problem.observations {
        Correspondences::Lines { lines } => lines[i].signed_distance(keypoint).abs() <= OFF_LINE_PX,
        Correspondences::Points { .. } | Correspondences::Anchored { .. } => true,
    }
}
