//! Graph distances from a few landmarks to all keypoints: Dijkstra's shortest paths over accepted edges.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;

use super::edges::Edges;

/// A heap entry, ordered by distance.
#[derive(PartialEq)]
struct HeapEntry {
    distance: f64,
    node: u32,
}

impl Eq for HeapEntry {}

impl Ord for HeapEntry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.distance.total_cmp(&other.distance).then(self.node.cmp(&other.node))
    }
}

impl PartialOrd for HeapEntry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// `[landmarks][n]`: length of the shortest path from each landmark; an edge `(i, j)` has the length `length · ½
/// (scale_i + scale_j)`. Infinite without a path.
pub(super) fn from_landmarks(edges: &Edges, landmarks: &[usize], scale: &[f64]) -> Vec<Vec<f64>> {
    landmarks.par_iter().map(|&l| shortest(edges, l, scale)).collect()
}

fn shortest(edges: &Edges, from: usize, scale: &[f64]) -> Vec<f64> {
    let mut distance = vec![f64::INFINITY; edges.len()];
    distance[from] = 0.0;
    let mut open = BinaryHeap::from([Reverse(HeapEntry { distance: 0.0, node: from as u32 })]);
    while let Some(Reverse(HeapEntry { distance: d, node })) = open.pop() {
        let i = node as usize;
        if d > distance[i] {
            continue;
        }
        for e in edges.of(i) {
            let j = e.to as usize;
            let way = d + e.length * f64::midpoint(scale[i], scale[j]);
            if way < distance[j] {
                distance[j] = way;
                open.push(Reverse(HeapEntry { distance: way, node: e.to }));
            }
        }
    }
    distance
}
