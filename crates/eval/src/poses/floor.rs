//! The floor: least squares from the true pose on the truly right matches, below which no estimator can be expected.

use veiloc_geometry::{Pixel, PlanePoint};
use veiloc_robust::{Correspondences, PoseProblem};

use veiloc_datasets::Problem;

/// A candidate line this far from its keypoint is the wrong one of two: dither and quantization move it by less.
const OFF_LINE_PX: f64 = 1.0;

/// Which correspondences are truly right, `[N]`: the map point projects within `radius_px` of the keypoint under the
/// true pose. Of two candidate lines of one keypoint, only the one through it can be.
///
/// `match_of[i]` is the match of the problem that correspondence `i` was made of.
pub(crate) fn truly_right(
    problem: &Problem,
    estimated: &PoseProblem,
    match_of: &[usize],
    radius_px: f64,
) -> Vec<bool> {
    let near = |m: usize, keypoint: Pixel| {
        let seen = problem.cam_from_world.transform(&problem.points[m]);
        PlanePoint::from_camera_point(&seen)
            .is_some_and(|p| problem.camera.project(p).distance(&keypoint) <= radius_px)
    };
    match_of
        .iter()
        .enumerate()
        .map(|(i, &m)| {
            let keypoint = problem.keypoints[problem.keypoint_of_match[m]];
            runs_through(estimated, i, keypoint) && near(m, keypoint)
        })
        .collect()
}

/// Whether the line of correspondence `i` runs through its keypoint: false for the wrong one of two candidate lines.
pub(crate) fn runs_through(estimated: &PoseProblem, i: usize, keypoint: Pixel) -> bool {
    match &estimated.observations {
        Correspondences::Lines { lines } => lines[i].signed_distance(keypoint).abs() <= OFF_LINE_PX,
        Correspondences::Points { .. } | Correspondences::Anchored { .. } => true,
    }
}
