//! The floor: least squares from the true pose on the true matches, a lower limit for estimators.

use veiloc_geometry::{CameraFromWorld, Pixel, PlanePoint};
use veiloc_pose::{Correspondences, PoseProblem};

/// Largest reprojection error of a true match, pixels: the paper's inlier threshold for images of 640 x 480.
pub const ORACLE_RADIUS_PX: f64 = 4.0;

/// A candidate line farther from its keypoint than this is the wrong one of two: dither and quantization move it by
/// less.
const OFF_LINE_PX: f64 = 1.0;

/// Which correspondences are true, `[N]`: the map point projects within `radius_px` of the keypoint under the true
/// pose. Of two candidate lines of one keypoint, only the line through it can be true.
///
/// `keypoints[k]` is the true position of keypoint `k` in the image of the problem's camera.
pub fn true_matches(
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

/// Whether the line of correspondence `i` passes through its keypoint: false for the wrong one of two candidate
/// lines.
pub(crate) fn runs_through(problem: &PoseProblem, i: usize, keypoint: Pixel) -> bool {
    match &problem.observations {
        Correspondences::Lines { lines } => lines[i].signed_distance(keypoint).abs() <= OFF_LINE_PX,
        Correspondences::Points { .. } | Correspondences::Anchored { .. } => true,
    }
}
