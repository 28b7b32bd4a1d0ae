//! Inliers of a pose as a server sees them: the projections of their map points, including those of wrong inliers.

use std::collections::BTreeMap;

use veiloc_geometry::{Pixel, PlanePoint};
use veiloc_pose::{PoseEstimate, PoseProblem};

/// Factors by which the depth limits extend the depths of the inliers.
const NEARER: f64 = 0.5;
const FARTHER: f64 = 2.0;

/// The map point of an inlier, projected.
pub(super) struct ProjectedInlier {
    row: usize,
    /// Log prior odds of its match.
    weight: f64,
    pub(super) pixel: Pixel,
    /// Map units.
    pub(super) depth: f64,
}

/// The inliers in front of the camera, in the order of the problem; `row_of`: the row of a correspondence.
pub(super) fn projected_inliers(
    problem: &PoseProblem,
    found: &PoseEstimate,
    row_of: impl Fn(usize) -> usize,
) -> Vec<ProjectedInlier> {
    let project = |i: usize| {
        let seen = found.cam_from_world.transform(&problem.points[i]);
        let plane = PlanePoint::from_camera_point(&seen)?;
        let weight = problem.prior.as_ref().map_or(0.0, |prior| prior[i]);
        Some(ProjectedInlier {
            row: row_of(i),
            weight,
            pixel: problem.camera.project(plane),
            depth: seen.depth(),
        })
    };
    (0..problem.points.len()).filter(|i| found.inliers[*i]).filter_map(project).collect()
}

/// Position and depth of the likeliest inlier of each row.
pub(super) fn likeliest_by_row(inliers: &[ProjectedInlier]) -> BTreeMap<usize, (Pixel, f64)> {
    let mut best: BTreeMap<usize, &ProjectedInlier> = BTreeMap::new();
    for inlier in inliers {
        let entry = best.entry(inlier.row).or_insert(inlier);
        if inlier.weight > entry.weight {
            *entry = inlier;
        }
    }
    best.into_iter().map(|(row, inlier)| (row, (inlier.pixel, inlier.depth))).collect()
}

/// Depths between which an attacker searches; `None` without depths.
pub(super) fn depth_limits(depths: impl Iterator<Item = f64> + Clone) -> Option<[f64; 2]> {
    let least = depths.clone().min_by(f64::total_cmp)?;
    Some([NEARER * least, FARTHER * depths.max_by(f64::total_cmp)?])
}
