//! Neighbour lists: the side information of the geometry-recovery attack.

use rand::Rng;
use rayon::prelude::*;
use veiloc_geometry::Pixel;

use crate::error::AttackError;

/// One list of neighbours per keypoint, nearest (or most likely) first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NeighbourLists {
    /// `[N + 1]`: list `i` is `entries[offsets[i]..offsets[i + 1]]`.
    offsets: Vec<usize>,
    entries: Vec<u32>,
}

impl NeighbourLists {
    /// From flat entries and `[N + 1]` offsets: list `i` is `entries[offsets[i]..offsets[i + 1]]`.
    ///
    /// # Errors
    /// [`AttackError::Offsets`] when the offsets do not rise from 0 to the number of entries,
    /// [`AttackError::UnknownNeighbour`] when an entry is `N` or more.
    pub fn new(offsets: Vec<usize>, entries: Vec<u32>) -> Result<Self, AttackError> {
        let rising = offsets.windows(2).all(|w| w[0] <= w[1]);
        if offsets.first() != Some(&0) || offsets.last() != Some(&entries.len()) || !rising {
            return Err(AttackError::Offsets { entries: entries.len() });
        }
        let observations = offsets.len() - 1;
        for list in 0..observations {
            for &index in &entries[offsets[list]..offsets[list + 1]] {
                if index as usize >= observations {
                    return Err(AttackError::UnknownNeighbour { list, index, observations });
                }
            }
        }
        Ok(Self { offsets, entries })
    }

    /// The same from one vector per keypoint.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn from_lists(lists: &[Vec<u32>]) -> Result<Self, AttackError> {
        let mut offsets = vec![0];
        let mut entries = Vec::new();
        for list in lists {
            entries.extend_from_slice(list);
            offsets.push(entries.len());
        }
        Self::new(offsets, entries)
    }

    /// The oracle: the `k` nearest true keypoints of each keypoint, without itself, nearest first; ties are ordered
    /// by index. Fewer if there are fewer keypoints. A keypoint that is not finite has no neighbours and is on no
    /// list.
    pub fn nearest(keypoints: &[Pixel], k: usize) -> Self {
        let grid = Grid::new(keypoints, k);
        let lists: Vec<Vec<u32>> =
            (0..keypoints.len()).into_par_iter().map(|i| grid.nearest(keypoints, i, k)).collect();
        Self::from_lists(&lists).expect("the grid only holds indices of keypoints")
    }

    /// The same lists with each entry replaced, with probability `share`, by a random keypoint other than the list's
    /// own: simulates a poor predictor of neighbours.
    pub fn corrupted(&self, share: f64, rng: &mut impl Rng) -> Self {
        let n = self.len() as u32;
        let mut entries = self.entries.clone();
        for i in 0..self.len() {
            for entry in &mut entries[self.offsets[i]..self.offsets[i + 1]] {
                if n > 1 && rng.random::<f64>() < share {
                    // One of the n − 1 other keypoints.
                    let other = rng.random_range(0..n - 1);
                    *entry = other + u32::from(other >= i as u32);
                }
            }
        }
        Self { offsets: self.offsets.clone(), entries }
    }

    /// The same lists restricted to the entries for which `keep(list, entry)` holds, in the same order.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(usize, u32) -> bool) -> Self {
        let mut offsets = vec![0];
        let mut entries = Vec::new();
        for i in 0..self.len() {
            entries.extend(self.of(i).iter().copied().filter(|j| keep(i, *j)));
            offsets.push(entries.len());
        }
        Self { offsets, entries }
    }

    /// Share of these entries that are also in the `true_lists`, 0 to 1; NaN without entries.
    pub fn precision(&self, true_lists: &Self) -> f64 {
        let lists = 0..self.len().min(true_lists.len());
        let right: usize =
            lists.map(|i| self.of(i).iter().filter(|j| true_lists.of(i).contains(j)).count()).sum();
        right as f64 / self.entries.len() as f64
    }

    /// Number of lists.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// True when there are no lists.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The neighbours of keypoint `i`.
    pub fn of(&self, i: usize) -> &[u32] {
        &self.entries[self.offsets[i]..self.offsets[i + 1]]
    }
}

/// Keypoints sorted into square cells, about `k / 4` of them in each.
struct Grid {
    low: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    /// `[columns · rows + 1]` into `members`.
    starts: Vec<usize>,
    members: Vec<u32>,
}

impl Grid {
    fn new(keypoints: &[Pixel], k: usize) -> Self {
        let finite = || keypoints.iter().filter(|p| p.is_finite());
        let count = finite().count();
        let low = finite().fold([f64::INFINITY; 2], |m, p| [m[0].min(p.u), m[1].min(p.v)]);
        let high = finite().fold([f64::NEG_INFINITY; 2], |m, p| [m[0].max(p.u), m[1].max(p.v)]);
        if count == 0 {
            return Self {
                low: [0.0; 2],
                cell: 1.0,
                columns: 1,
                rows: 1,
                starts: vec![0, 0],
                members: vec![],
            };
        }
        let size = [high[0] - low[0], high[1] - low[1]];
        let per_cell = (k as f64 / 4.0).clamp(1.0, count as f64);
        let cell = ((size[0] * size[1]) * per_cell / count as f64).sqrt();
        // At most about as many cells as keypoints, even if all keypoints lie on one line.
        let cell = cell.max((size[0] + size[1]) * per_cell / count as f64).max(1e-9);
        let columns = (size[0] / cell) as usize + 1;
        let rows = (size[1] / cell) as usize + 1;
        let mut grid =
            Self { low, cell, columns, rows, starts: vec![0; columns * rows + 1], members: vec![] };
        let mut cells = vec![Vec::new(); columns * rows];
        for (i, p) in keypoints.iter().enumerate().filter(|(_, p)| p.is_finite()) {
            let [x, y] = grid.cell_of(*p);
            cells[y * columns + x].push(i as u32);
        }
        for (c, members) in cells.iter().enumerate() {
            grid.members.extend_from_slice(members);
            grid.starts[c + 1] = grid.members.len();
        }
        grid
    }

    fn cell_of(&self, p: Pixel) -> [usize; 2] {
        let at = |x: f64, low: f64, n: usize| (((x - low) / self.cell) as usize).min(n - 1);
        [at(p.u, self.low[0], self.columns), at(p.v, self.low[1], self.rows)]
    }

    fn nearest(&self, keypoints: &[Pixel], i: usize, k: usize) -> Vec<u32> {
        let p = keypoints[i];
        if !p.is_finite() || k == 0 {
            return vec![];
        }
        let [x, y] = self.cell_of(p);
        let mut found: Vec<(f64, u32)> = Vec::new();
        for ring in 0..self.columns.max(self.rows) {
            self.ring(x, y, ring, |j| {
                if j as usize != i {
                    let q = keypoints[j as usize];
                    found.push(((q.u - p.u).powi(2) + (q.v - p.v).powi(2), j));
                }
            });
            // Everything within `ring` cell widths of the own cell's border has been visited.
            let covered = ring as f64 * self.cell;
            if found.iter().filter(|f| f.0 <= covered * covered).count() >= k {
                break;
            }
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(k);
        found.into_iter().map(|f| f.1).collect()
    }

    /// Calls `visit` with every member of the cells at exactly this chessboard distance.
    fn ring(&self, x: usize, y: usize, ring: usize, mut visit: impl FnMut(u32)) {
        let rows = y.saturating_sub(ring)..=(y + ring).min(self.rows - 1);
        for row in rows {
            let edge = row.abs_diff(y) == ring;
            let columns = x.saturating_sub(ring)..=(x + ring).min(self.columns - 1);
            for column in columns.filter(|c| edge || c.abs_diff(x) == ring) {
                let c = row * self.columns + column;
                self.members[self.starts[c]..self.starts[c + 1]].iter().for_each(|&j| visit(j));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn brute_force(keypoints: &[Pixel], i: usize, k: usize) -> Vec<u32> {
        let mut all: Vec<(f64, u32)> = keypoints
            .iter()
            .enumerate()
            .filter(|(j, q)| *j != i && q.is_finite())
            .map(|(j, q)| ((q.u - keypoints[i].u).powi(2) + (q.v - keypoints[i].v).powi(2), j as u32))
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(k);
        all.into_iter().map(|a| a.1).collect()
    }

    #[test]
    fn grid_search_equals_brute_force() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for case in 0..40 {
            let n = [1, 2, 5, 30, 300][case % 5];
            let k = [0, 1, 7, 20][case % 4];
            let clustered = case % 3;
            let points: Vec<Pixel> = (0..n)
                .map(|i| match clustered {
                    0 => Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)),
                    1 => Pixel::new((i / 3) as f64, 5.0), // on one line, with repetitions
                    _ => Pixel::new(
                        300.0 + rng.random_range(0.0f64..8.0).powi(2),
                        rng.random_range(0.0..2000.0),
                    ),
                })
                .collect();
            let lists = NeighbourLists::nearest(&points, k);
            for i in 0..n {
                assert_eq!(lists.of(i), brute_force(&points, i, k), "case {case}, keypoint {i}");
            }
        }
    }

    #[test]
    fn non_finite_keypoints_have_no_neighbours() {
        let points = [Pixel::new(1.0, 1.0), Pixel::new(f64::NAN, 1.0), Pixel::new(3.0, 1.0)];
        let lists = NeighbourLists::nearest(&points, 5);
        assert_eq!((lists.of(0), lists.of(1), lists.of(2)), (&[2][..], &[][..], &[0][..]));
        assert!(NeighbourLists::nearest(&[], 5).is_empty());
    }

    #[test]
    fn invalid_lists_are_refused() {
        assert!(matches!(NeighbourLists::new(vec![], vec![]), Err(AttackError::Offsets { .. })));
        assert!(matches!(NeighbourLists::new(vec![0, 2, 1], vec![0]), Err(AttackError::Offsets { .. })));
        let unknown = NeighbourLists::from_lists(&[vec![1], vec![2]]).expect_err("there is no third");
        assert_eq!(unknown, AttackError::UnknownNeighbour { list: 1, index: 2, observations: 2 });
    }
}
