//! Track completion after triangulation: points gain observations, and duplicate points are merged.

use std::collections::BTreeSet;

use rayon::prelude::*;
use veiloc_geometry::Pixel;
use veiloc_map::BuildSettings;

use crate::triangulation::matching::Edge;
use crate::triangulation::scene::{Fallback, Scene};
use crate::triangulation::tracks::Node;
use crate::triangulation::triangulate::refine_inliers;

/// Extends a scene with new edges, until no point gains an observation.
pub(crate) fn grow(scene: &mut Scene<'_>, edges: &[Edge], settings: &BuildSettings) {
    let neighbours = neighbours(scene.views.len(), edges);
    attach(scene, edges);
    scene.new_points(edges, settings);
    for _ in 0..ROUNDS {
        merge(scene, edges, settings);
        attach(scene, edges);
        find_by_projection(scene, &neighbours);
        scene.refine_touched(settings, Fallback::Restore);
    }
}

/// Assigns keypoints without a point to the point of a matched keypoint, if it projects near them.
fn attach(scene: &mut Scene<'_>, edges: &[Edge]) {
    // Along a chain of matches one keypoint follows another; the best edges come first, so a few passes suffice.
    for _ in 0..ATTACH_PASSES {
        let mut attached = 0;
        for edge in edges {
            let (index, node) = match (scene.point_at(edge.a), scene.point_at(edge.b)) {
                (Some(point), None) => (point, edge.b),
                (None, Some(point)) => (point, edge.a),
                _ => continue,
            };
            let point = &scene.points[index as usize];
            let agrees = scene.observation(node).is_some_and(|s| s.agrees(&point.position));
            if agrees && !point.sees(node.0) {
                scene.points[index as usize].insert(node);
                scene.assign(node, Some(index));
                attached += 1;
            }
        }
        if attached == 0 {
            break;
        }
    }
}

/// Merges two points that a match connects, if all their keypoints agree on one position.
fn merge(scene: &mut Scene<'_>, edges: &[Edge], settings: &BuildSettings) {
    let mut tried = BTreeSet::new();
    for edge in edges {
        let (Some(a), Some(b)) = (scene.point_at(edge.a), scene.point_at(edge.b)) else { continue };
        if a == b || !tried.insert((a.min(b), a.max(b))) {
            continue;
        }
        let (keep, give) = {
            let (p, q) = (&scene.points[a as usize], &scene.points[b as usize]);
            if (p.track.len(), b) >= (q.track.len(), a) { (a, b) } else { (b, a) }
        };
        let (p, q) = (&scene.points[keep as usize], &scene.points[give as usize]);
        // One image may contain two keypoints of one point, but only close to each other.
        let (doubled, joining): (Vec<Node>, Vec<Node>) = q.track.iter().partition(|n| p.sees(n.0));
        let together = |node: &Node| scene.observation(*node).is_some_and(|s| s.agrees(&p.position));
        if joining.is_empty() || !doubled.iter().all(together) {
            continue;
        }
        let mut union: Vec<Node> = p.track.iter().chain(&joining).copied().collect();
        union.sort_unstable();
        let (nodes, observations) = scene.observations(&union);
        let found = refine_inliers(
            &observations,
            p.position,
            settings.min_track_length as usize,
            settings.min_triangulation_angle_deg,
        );
        let Some(found) = found.filter(|f| nodes.len() == union.len() && f.agree.iter().all(|a| *a)) else {
            continue;
        };
        for node in std::mem::take(&mut scene.points[give as usize].track) {
            scene.assign(node, None);
        }
        scene.points[give as usize].touched = true;
        for node in &joining {
            scene.assign(*node, Some(keep));
        }
        let merged_point = &mut scene.points[keep as usize];
        (merged_point.position, merged_point.track, merged_point.touched) = (found.position, union, true);
    }
}

/// Searches keypoints of the touched points near their projections in neighbouring images. This recovers matches that
/// the ratio test rejected because of repeated structure or duplicate keypoints; with a known 3D point they are safe.
fn find_by_projection(scene: &mut Scene<'_>, neighbours: &[BTreeSet<u32>]) {
    let free: Vec<Grid> = (0..scene.views.len())
        .into_par_iter()
        .map(|i| {
            let pixels = scene.keypoints[i].iter().zip(&scene.point_of[i]);
            let free = pixels.enumerate().filter(|(_, (_, point))| point.is_none());
            Grid::new(free.map(|(k, (pixel, _))| (k as u32, *pixel)), scene.views[i].max_error)
        })
        .collect();
    let mut found: Vec<(u32, u32, Node)> = (0..scene.points.len())
        .into_par_iter()
        .flat_map_iter(|index| candidates(scene, index as u32, neighbours, &free))
        .collect();
    found.sort_unstable();
    for (_, index, node) in found {
        let point = &mut scene.points[index as usize];
        if !point.sees(node.0) && scene.point_of[node.0 as usize][node.1 as usize].is_none() {
            point.insert(node);
            scene.assign(node, Some(index));
        }
    }
}

/// Returns for each neighbouring image the most similar free keypoint near the projection of a point: squared
/// descriptor distance, point, keypoint.
fn candidates(
    scene: &Scene<'_>,
    index: u32,
    neighbours: &[BTreeSet<u32>],
    free: &[Grid],
) -> Vec<(u32, u32, Node)> {
    let point = &scene.points[index as usize];
    if !point.touched || point.track.is_empty() {
        return Vec::new();
    }
    let images: BTreeSet<u32> = point
        .track
        .iter()
        .flat_map(|n| &neighbours[n.0 as usize])
        .copied()
        .filter(|i| !point.sees(*i))
        .collect();
    let step = point.track.len().div_ceil(MAX_COMPARED);
    let rows: Vec<&[u8]> = point
        .track
        .iter()
        .step_by(step)
        .map(|(image, keypoint)| scene.descriptors[*image as usize].row(*keypoint as usize))
        .collect();
    images
        .into_iter()
        .filter_map(|image| {
            let i = image as usize;
            let pixel = scene.views[i].pixel_inside(&point.position)?;
            let max_distance = scene.descriptors[i].kind().same_point_distance();
            free[i]
                .near(pixel)
                .filter(|k| scene.observation((image, *k)).is_some_and(|s| s.agrees(&point.position)))
                .map(|k| {
                    let own = scene.descriptors[i].row(k as usize);
                    let distance =
                        rows.iter().map(|row| squared_distance(row, own)).min().unwrap_or(u32::MAX);
                    (distance, index, (image, k))
                })
                .filter(|(distance, ..)| *distance <= max_distance)
                .min()
        })
        .collect()
}

/// Valid for offset codes too: the offset cancels.
fn squared_distance(a: &[u8], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(x, y)| u32::from(x.abs_diff(*y)).pow(2)).sum()
}

/// Images with verified matches to each image.
fn neighbours(images: usize, edges: &[Edge]) -> Vec<BTreeSet<u32>> {
    let mut all = vec![BTreeSet::new(); images];
    for edge in edges {
        all[edge.a.0 as usize].insert(edge.b.0);
        all[edge.b.0 as usize].insert(edge.a.0);
    }
    all
}

/// Spatial index of the keypoints of one image.
pub(crate) struct Grid {
    cell: f64,
    /// Column and row of the cell, keypoint; sorted.
    cells: Vec<((i32, i32), u32)>,
}

impl Grid {
    /// Creates an index for queries with this radius, pixels.
    pub(crate) fn new(keypoints: impl Iterator<Item = (u32, [f32; 2])>, radius: f64) -> Self {
        let cell = |c: f32| (f64::from(c) / radius).floor() as i32;
        let mut cells: Vec<_> = keypoints.map(|(k, [u, v])| ((cell(u), cell(v)), k)).collect();
        cells.sort_unstable();
        Self { cell: radius, cells }
    }

    /// A superset of the keypoints within the radius, column by column.
    pub(crate) fn near(&self, pixel: Pixel) -> impl Iterator<Item = u32> {
        let (column, row) = ((pixel.u / self.cell).floor() as i32, (pixel.v / self.cell).floor() as i32);
        (column.saturating_sub(1)..=column.saturating_add(1)).flat_map(move |c| {
            let begin = self.cells.partition_point(|(cell, _)| *cell < (c, row.saturating_sub(1)));
            let end = self.cells.partition_point(|(cell, _)| *cell <= (c, row.saturating_add(1)));
            self.cells[begin..end].iter().map(|(_, k)| *k)
        })
    }
}

/// Rounds of merging, attaching and refining.
const ROUNDS: usize = 2;
/// Passes over the edges when keypoints are attached.
const ATTACH_PASSES: usize = 3;
/// Descriptors of a track that a candidate is compared with.
const MAX_COMPARED: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_returns_all_keypoints_within_radius() {
        let keypoints: Vec<[f32; 2]> =
            (0..500).map(|i| [(i * 37 % 101) as f32 * 0.93 - 3.0, (i * 53 % 89) as f32 * 1.07]).collect();
        let grid = Grid::new((0..).zip(keypoints.iter().copied()), 4.0);
        for i in 0..200 {
            let at = Pixel::new(f64::from(i * 29 % 97), f64::from(i * 17 % 91));
            let near: BTreeSet<u32> = grid.near(at).collect();
            for (k, [u, v]) in (0..).zip(&keypoints) {
                let within = at.distance(&Pixel::new(f64::from(*u), f64::from(*v))) <= 4.0;
                assert!(!within || near.contains(&k));
                // Only neighbouring cells are searched, so the superset is bounded.
                let reach = (at.u - f64::from(*u)).abs().max((at.v - f64::from(*v)).abs());
                assert!(reach < 8.0 || !near.contains(&k), "{k} is {reach} px away");
            }
        }
        assert_eq!(grid.near(Pixel::new(f64::NAN, f64::INFINITY)).count(), 0);
    }
}
