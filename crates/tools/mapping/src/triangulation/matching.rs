//! Matches two images and verifies the matches with the known poses.

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorView, MatchOptions, match_descriptors};
use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};

use crate::input::cache::BuildCache;
use crate::progress::Progress;
use crate::triangulation::triangulate::{ViewObservation, nearest_to_both_rays};
use crate::triangulation::view::View;

/// Two keypoints with similar descriptors that lie on each other's epipolar lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    /// Image and keypoint; the image with the lower index comes first.
    pub(crate) a: (u32, u32),
    /// Image and keypoint.
    pub(crate) b: (u32, u32),
    /// Nearest over second-nearest descriptor distance.
    pub(crate) ratio: f32,
    /// Descriptor distance, code units.
    pub(crate) distance: f32,
}

/// Result of matching.
#[derive(Debug, Clone, Default)]
pub(crate) struct Edges {
    /// Matches that agree with the poses, in the order of the pairs.
    pub(crate) verified: Vec<Edge>,
    /// Number of matches before the verification.
    pub(crate) matches: usize,
}

impl Edges {
    pub(crate) fn extend(&mut self, other: Self) {
        self.verified.extend(other.verified);
        self.matches += other.matches;
    }

    /// Sorts by ratio, best first, then by position, so that the order is deterministic.
    pub(crate) fn sort(&mut self) {
        self.verified.sort_by(|x, y| x.ratio.total_cmp(&y.ratio).then_with(|| (x.a, x.b).cmp(&(y.a, y.b))));
    }
}

/// Matches the pairs and verifies the matches; in the order of the pairs for any number of threads. `cache`: the cache
/// of matches, and the cache key of each image's descriptors.
pub(crate) fn match_pairs(
    pairs: &[(u32, u32)],
    views: &[View],
    descriptors: &[DescriptorView<'_>],
    max_ratio: f32,
    cache: Option<(&dyn BuildCache, &[[u8; 32]])>,
    progress: &dyn Progress,
) -> Edges {
    let options = MatchOptions::default().with_mutual(true).with_max_ratio(Some(max_ratio));
    let found: Vec<Edges> = pairs
        .par_iter()
        .map(|&(i, j)| {
            let (a, b) = (i as usize, j as usize);
            let find = || match_descriptors(descriptors[a], descriptors[b], &options);
            let matches = match cache {
                Some((cache, keys)) => cache.matches(&keys[a], &keys[b], &options).unwrap_or_else(|| {
                    let found = find();
                    cache.store_matches(&keys[a], &keys[b], &options, &found);
                    found
                }),
                None => find(),
            };
            let relation = Epipolar::between(&views[a], &views[b]);
            let verified = matches
                .iter()
                .filter(|m| {
                    relation.is_consistent(&views[a], m.query as usize, &views[b], m.database as usize)
                })
                .map(|m| Edge { a: (i, m.query), b: (j, m.database), ratio: m.ratio, distance: m.distance })
                .collect();
            progress.advance(1);
            Edges { verified, matches: matches.len() }
        })
        .collect();
    let mut all = Edges::default();
    for edges in found {
        all.extend(edges);
    }
    all
}

/// The epipolar geometry of two views, `x_bᵀ E x_a = 0` on the planes `z = 1`.
pub(crate) struct Epipolar {
    essential: Matrix3<f64>,
}

impl Epipolar {
    pub(crate) fn between(a: &View, b: &View) -> Self {
        let b_from_a = b.cam_from_world.compose(&a.cam_from_world.inverse());
        let t = b_from_a.translation();
        Self { essential: t.cross_matrix() * b_from_a.rotation().matrix() }
    }

    /// Returns whether two keypoints may observe one point: each lies near the other's epipolar line, and their rays
    /// intersect in front of both cameras.
    pub(crate) fn is_consistent(&self, a: &View, keypoint_a: usize, b: &View, keypoint_b: usize) -> bool {
        let (Some(x), Some(y)) = (a.plane[keypoint_a], b.plane[keypoint_b]) else { return false };
        let homogeneous = |p: &Vector2<f64>| Vector3::new(p.x, p.y, 1.0);
        let line_in_b = self.essential * homogeneous(&x);
        let line_in_a = self.essential.tr_mul(&homogeneous(&y));
        let product = homogeneous(&y).dot(&line_in_b).abs();
        // Written so that NaN, from two views at the same position, fails.
        let near = product * b.mean_focal() <= b.max_epipolar_error * line_in_b.xy().norm()
            && product * a.mean_focal() <= a.max_epipolar_error * line_in_a.xy().norm();
        if !near {
            return false;
        }
        let (observation_a, observation_b) =
            (ViewObservation { view: a, plane: x }, ViewObservation { view: b, plane: y });
        let (d, e) = (a.ray(&x).normalize(), b.ray(&y).normalize());
        // Almost parallel rays intersect far away, in front or behind depending on noise.
        d.cross(&e).norm() < NEARLY_PARALLEL || nearest_to_both_rays(&observation_a, &observation_b).is_some()
    }
}

/// Sine of the angle below which the intersection of rays is not checked: 0.2 degrees, two pixels of a phone's image.
const NEARLY_PARALLEL: f64 = 0.0035;
