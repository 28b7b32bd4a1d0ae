//! Which listed neighbours are accepted as edges, and how long accepted edges are: shared neighbours.
//!
//! Two keypoints near each other share most of their neighbours; the ends of a false edge share neighbours only by
//! chance. With lists of `k_i` and `k_j` among `n` keypoints, the number of entries shared by chance is Poisson with
//! mean `k_i k_j / n`; an edge is accepted when its count is improbable under that distribution. A second count among
//! accepted edges only was tried and did not help: it restores true edges but also false ones between dense regions,
//! or, with the edges of the first count dropped, splits the graph into islands.

use crate::neighbours::NeighbourLists;

/// An accepted edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Edge {
    pub(super) to: u32,
    /// `√(1 − J)`, `J` the share of common neighbours (Jaccard's index): grows with the distance, in units of the
    /// local distance to the `k`-th neighbour.
    pub(super) length: f64,
}

/// Accepted edges, symmetric, sorted by end.
pub(super) struct Edges {
    of: Vec<Vec<Edge>>,
    /// Share of the listed neighbours that are rejected.
    pub(super) rejected: f64,
}

/// Largest probability of the count under chance for which an edge is accepted.
const SURPRISE: f64 = 1e-3;

impl Edges {
    pub(super) fn accepted(lists: &NeighbourLists) -> Self {
        let n = lists.len();
        // Both directions: a false entry is rarely mutual, a true entry usually is.
        let mut ends: Vec<Vec<u32>> = vec![Vec::new(); n];
        for i in 0..n {
            for &j in lists.of(i).iter().filter(|j| **j as usize != i) {
                ends[i].push(j);
                ends[j as usize].push(i as u32);
            }
        }
        for list in &mut ends {
            list.sort_unstable();
            list.dedup();
        }
        let own: Vec<Vec<u32>> = (0..n).map(|i| closed_neighbourhood(lists.of(i), i)).collect();
        let of = keep(&ends, &own, n);
        let listed: usize = (0..n).map(|i| lists.of(i).len()).sum();
        let accepted: usize = (0..n)
            .map(|i| lists.of(i).iter().filter(|j| of[i].binary_search_by_key(*j, |e| e.to).is_ok()).count())
            .sum();
        Self { of, rejected: 1.0 - accepted as f64 / listed.max(1) as f64 }
    }

    pub(super) fn len(&self) -> usize {
        self.of.len()
    }

    pub(super) fn of(&self, i: usize) -> &[Edge] {
        &self.of[i]
    }

    /// The accepted neighbours as lists.
    pub(super) fn lists(&self) -> NeighbourLists {
        let lists: Vec<Vec<u32>> = self.of.iter().map(|l| l.iter().map(|e| e.to).collect()).collect();
        NeighbourLists::from_lists(&lists).expect("ends are indices of observations")
    }
}

/// The list plus the keypoint itself, sorted.
fn closed_neighbourhood(list: &[u32], i: usize) -> Vec<u32> {
    let mut all: Vec<u32> = list.iter().copied().chain([i as u32]).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The edges whose ends share more neighbours than chance explains.
fn keep(ends: &[Vec<u32>], closed_neighbourhood: &[Vec<u32>], n: usize) -> Vec<Vec<Edge>> {
    let edge = |i: usize, j: u32| {
        let (a, b) = (&closed_neighbourhood[i], &closed_neighbourhood[j as usize]);
        let common = common(a, b);
        // The edge itself puts each end into the other's list.
        let mutual =
            usize::from(a.binary_search(&j).is_ok()) + usize::from(b.binary_search(&(i as u32)).is_ok());
        let chance = a.len() as f64 * b.len() as f64 / n as f64;
        let jaccard = common as f64 / (a.len() + b.len() - common) as f64;
        (poisson_tail(common.saturating_sub(mutual), chance) < SURPRISE)
            .then(|| Edge { to: j, length: (1.0 - jaccard).max(0.01).sqrt() })
    };
    ends.iter().enumerate().map(|(i, list)| list.iter().filter_map(|&j| edge(i, j)).collect()).collect()
}

fn common(a: &[u32], b: &[u32]) -> usize {
    let (mut x, mut y, mut count) = (0, 0, 0);
    while x < a.len() && y < b.len() {
        match a[x].cmp(&b[y]) {
            std::cmp::Ordering::Less => x += 1,
            std::cmp::Ordering::Greater => y += 1,
            std::cmp::Ordering::Equal => {
                count += 1;
                x += 1;
                y += 1;
            }
        }
    }
    count
}

/// Probability of `count` or more where `mean` are expected.
fn poisson_tail(count: usize, mean: f64) -> f64 {
    let mut term = (-mean).exp();
    let mut below = 0.0;
    for k in 0..count {
        below += term;
        term *= mean / (k + 1) as f64;
    }
    1.0 - below
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::Pixel;

    #[test]
    fn false_edges_are_rejected_and_true_edges_kept() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let points: Vec<Pixel> = (0..1500)
            .map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)))
            .collect();
        let nearest = NeighbourLists::nearest(&points, 20);
        for (share, least) in [(0.0, 0.99), (0.2, 0.85), (0.5, 0.3)] {
            let lists = nearest.corrupted(share, &mut rng);
            let edges = Edges::accepted(&lists);
            let (mut kept, mut long) = (0_usize, 0_usize);
            for i in 0..points.len() {
                for e in edges.of(i) {
                    kept += 1;
                    long += usize::from(points[i].distance(&points[e.to as usize]) > 80.0);
                    assert!(edges.of(e.to as usize).iter().any(|b| b.to as usize == i), "symmetric");
                }
            }
            assert!(long * 500 < kept, "{share}: {long} of {kept}");
            assert!(edges.rejected < 1.0 - least * (1.0 - share), "{share}: {} rejected", edges.rejected);
        }
    }

    #[test]
    fn poisson_tail_matches_reference() {
        assert_eq!(poisson_tail(0, 3.0), 1.0);
        assert!((poisson_tail(2, 0.5) - (1.0 - 1.5 * (-0.5f64).exp())).abs() < 1e-15);
    }
}
