//! Likelihood of the neighbour lists given positions, and maximisation of it over positions.
//!
//! A true list names the `k` nearest keypoints, so `j` is on the list of `i` when it lies within some radius `ρ_i`.
//! The radius is unknown and varies with the local density of keypoints. With a share `q` of false entries and a soft
//! edge of relative width `s`,
//!
//! ```text
//! P(j on list of i | d_ij) = (1 − q) σ((ρ_i − d_ij) / (s ρ_i)) + q k / n
//! ```
//!
//! and the cost is `−Σ log P` over listed pairs `− Σ log(1 − P)` over pairs that are near but not listed. No absolute
//! distance is assumed: only the order of distances around each keypoint matters, so the density of keypoints does
//! not.
//!
//! Each `ρ_i` is set to its minimiser. With any other radius (for example from counting neighbours) the pairs have a
//! common radial gradient, and on half-lines that converge the whole layout grows or shrinks by tens of pixels; at
//! the best radius this gradient is zero.
//!
//! `s` decreases from sweep to sweep (coarse to fine), so layouts far from the optimum converge first; `q` is
//! estimated on the way.

use rayon::prelude::*;
use veiloc_geometry::nalgebra::Vector2;

use super::line_constraint::{LineConstraint, pixels, positions};
use super::newton::{self, PairCost};
use crate::metrics::median;
use crate::neighbours::NeighbourLists;

/// The cost of layouts, with the parameters that are estimated beside the positions.
pub(super) struct ListLikelihood<'a> {
    constraints: &'a [LineConstraint],
    lists: &'a NeighbourLists,
    /// Sorted listed neighbours of each keypoint, for look-up.
    sorted: Vec<Vec<u32>>,
    radii: Vec<f64>,
    /// Share of false entries.
    false_share: f64,
    estimate_share: bool,
}

/// A pair of keypoints; the owner of the list comes first.
#[derive(Clone, Copy)]
struct Candidate {
    i: u32,
    j: u32,
    distance: f64,
    listed: bool,
}

/// Lower bound of the share of false entries: it bounds the weight of a single false entry.
const MIN_FALSE_SHARE: f64 = 0.01;
const MAX_FALSE_SHARE: f64 = 0.98;

/// Pairs that are not listed are considered up to this multiple of the list's length, in keypoints.
const SEARCH_RANGE: f64 = 2.5;

impl<'a> ListLikelihood<'a> {
    pub(super) fn new(
        constraints: &'a [LineConstraint],
        lists: &'a NeighbourLists,
        start_share: f64,
        known_share: Option<f64>,
    ) -> Self {
        let sorted = (0..lists.len())
            .map(|i| {
                let mut list: Vec<u32> = lists.of(i).iter().copied().filter(|j| *j as usize != i).collect();
                list.sort_unstable();
                list.dedup();
                list
            })
            .collect();
        let false_share = known_share.unwrap_or(start_share).clamp(MIN_FALSE_SHARE, MAX_FALSE_SHARE);
        Self {
            constraints,
            lists,
            sorted,
            radii: Vec::new(),
            false_share,
            estimate_share: known_share.is_none(),
        }
    }

    /// Share of false entries estimated by the last sweep.
    pub(super) const fn false_share(&self) -> f64 {
        self.false_share
    }

    /// Improves `t` by this many sweeps while the soft edge narrows from `wide` to `narrow`; returns the final cost
    /// per keypoint.
    pub(super) fn improve(&mut self, t: &mut [f64], sweeps: usize, wide: f64, narrow: f64) -> f64 {
        let mut cost = f64::INFINITY;
        for sweep in 0..sweeps {
            let done = sweep as f64 / (sweeps.max(2) - 1) as f64;
            let width = wide * (narrow / wide).powf(done);
            let x = positions(self.constraints, t);
            let candidates = self.candidates(t, &x);
            for _ in 0..3 {
                self.fit_radii(&candidates, width);
            }
            let pairs: Vec<PairCost> = candidates.par_iter().map(|c| self.pair(c, width)).collect();
            cost = self.cost(&candidates, width) / t.len().max(1) as f64;
            if self.estimate_share {
                self.estimate(&candidates, width);
            }
            newton::step(self.constraints, &x, &pairs, t, self.typical_radius());
        }
        cost
    }

    /// All listed pairs and the near pairs that are not listed. The initial radius encloses as many keypoints as the
    /// list has entries, and the radius stays near that value.
    fn candidates(&mut self, t: &[f64], x: &[Vector2<f64>]) -> Vec<Candidate> {
        let longest = self.sorted.iter().map(Vec::len).max().unwrap_or(0);
        let around =
            NeighbourLists::nearest(&pixels(self.constraints, t), (longest as f64 * SEARCH_RANGE) as usize);
        let mut counted: Vec<f64> = (0..t.len())
            .map(|i| {
                let near = around.of(i);
                let k = self.sorted[i].len().clamp(1, near.len().max(1));
                let at =
                    |k: usize| near.get(k).or(near.last()).map_or(0.0, |j| (x[*j as usize] - x[i]).norm());
                f64::midpoint(at(k - 1), at(k))
            })
            .collect();
        let floor = 0.1 * median(counted.clone()).max(1e-3);
        for radius in &mut counted {
            *radius = radius.max(floor);
        }
        if self.radii.is_empty() {
            self.radii.clone_from(&counted);
        }
        for (radius, counted) in self.radii.iter_mut().zip(&counted) {
            *radius = radius.max(0.3 * counted).min(1.8 * counted);
        }

        let (sorted, around) = (&self.sorted, &around);
        (0..t.len())
            .into_par_iter()
            .flat_map_iter(|i| {
                let listed = sorted[i].iter().map(|&j| (j, true));
                let others = around.of(i).iter().filter(move |j| sorted[i].binary_search(j).is_err());
                listed.chain(others.map(|&j| (j, false))).map(move |(j, listed)| Candidate {
                    i: i as u32,
                    j,
                    distance: (x[j as usize] - x[i]).norm().max(1e-2),
                    listed,
                })
            })
            .collect()
    }

    fn typical_radius(&self) -> f64 {
        median(self.radii.clone()).max(1.0)
    }

    /// `σ`, and `P`.
    fn probability(&self, c: &Candidate, width: f64) -> (f64, f64) {
        let radius = self.radii[c.i as usize];
        let z = ((c.distance - radius) / (width * radius)).clamp(-30.0, 30.0);
        let inside = 1.0 / (1.0 + z.exp());
        let by_chance = self.false_share * self.sorted[c.i as usize].len() as f64 / self.lists.len() as f64;
        (inside, (1.0 - self.false_share) * inside + by_chance.min(0.5))
    }

    fn pair(&self, c: &Candidate, width: f64) -> PairCost {
        let (inside, p) = self.probability(c, width);
        let soft = width * self.radii[c.i as usize];
        let true_share = 1.0 - self.false_share;
        let steep = true_share * inside * (1.0 - inside) / soft;
        let (slope, posterior) = if c.listed {
            (steep / p, true_share * inside / p)
        } else {
            (-steep / (1.0 - p), (1.0 - inside) / (1.0 - p))
        };
        let curvature =
            (inside * (1.0 - inside)).max(0.05 * slope.abs() * soft) / (soft * soft) * posterior.min(1.0);
        PairCost { i: c.i, j: c.j, slope, curvature }
    }

    fn fit_radii(&mut self, candidates: &[Candidate], width: f64) {
        let n = self.radii.len();
        let (mut slope, mut curvature) = (vec![0.0; n], vec![1.0; n]);
        for c in candidates {
            let pair = self.pair(c, width);
            // d cost / d log ρ = −d · d cost / dd
            slope[c.i as usize] += pair.slope * c.distance;
            curvature[c.i as usize] += pair.curvature * c.distance * c.distance;
        }
        for ((r, s), c) in self.radii.iter_mut().zip(slope).zip(curvature) {
            *r *= (s / c).clamp(-0.1, 0.1).exp();
        }
    }

    fn cost(&self, candidates: &[Candidate], width: f64) -> f64 {
        let of = |c: &Candidate| {
            let p = self.probability(c, width).1;
            -(if c.listed { p } else { 1.0 - p }).max(1e-12).ln()
        };
        candidates.iter().map(of).sum()
    }

    /// Soft estimate of the share of listed pairs that are more likely false than true.
    fn estimate(&mut self, candidates: &[Candidate], width: f64) {
        let (mut listed, mut right) = (0.0, 0.0);
        for c in candidates.iter().filter(|c| c.listed) {
            let (inside, p) = self.probability(c, width);
            listed += 1.0;
            right += (1.0 - self.false_share) * inside / p;
        }
        if listed > 0.0 {
            let share: f64 = 1.0 - right / listed;
            self.false_share = f64::midpoint(self.false_share, share).clamp(MIN_FALSE_SHARE, MAX_FALSE_SHARE);
        }
    }
}
