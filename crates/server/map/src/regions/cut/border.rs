//! Refinement of the border between two halves, to minimize the points observed from both sides.
//!
//! Fiduccia and Mattheyses (1982): images change sides one at a time, the one with the greatest gain (or smallest
//! loss) first, each once per pass; the best border of the pass is kept. So a pass can leave local minima of single
//! moves. Passes repeat until one gives no improvement.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::covisibility::Covisibility;

/// Maximum number of passes; three or four are usual.
const MAX_PASSES: usize = 16;
/// A pass ends after this many moves, and a tenth of the images, without improvement.
const MAX_FRUITLESS_MOVES: usize = 100;
/// Allowed deviation of the sizes, as a share of the smaller half.
const SLACK: f64 = 0.1;

/// Allowed sizes of the left half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct HalfSizes {
    /// Size proportional to its number of cores.
    pub(super) target: usize,
    min: usize,
    max: usize,
}

impl HalfSizes {
    /// For this many images and cores on the left and right, with at most `core` images per core.
    pub(super) fn new(images: usize, left: usize, right: usize, core: usize) -> Self {
        // At most the capacity of the cores, at least one image per core.
        let min = images.saturating_sub(right.saturating_mul(core)).max(left);
        let max = left.saturating_mul(core).min(images - right);
        let target = (images as f64 * left as f64 / (left + right) as f64).round() as usize;
        let target = target.clamp(min, max);
        let slack = (target.min(images - target) as f64 * SLACK) as usize;
        Self { target, min: min.max(target.saturating_sub(slack)), max: max.min(target + slack) }
    }
}

/// A bisection of some images.
pub(super) struct Border<'a> {
    shared: &'a Covisibility,
    images: &'a [u32],
    /// By index in `images`.
    is_left: Vec<bool>,
    cost: u64,
}

/// A possible move: gain, and index; ties go to the lowest index.
type Move = (i64, Reverse<usize>);

impl<'a> Border<'a> {
    /// From images in ascending order, and those on the left.
    pub(super) fn new(shared: &'a Covisibility, images: &'a [u32], left: &[u32]) -> Self {
        let mut is_left = vec![false; images.len()];
        for image in left {
            if let Ok(index) = images.binary_search(image) {
                is_left[index] = true;
            }
        }
        let mut border = Self { shared, images, is_left, cost: 0 };
        border.cost = (0..images.len())
            .flat_map(|index| border.neighbours(index).map(move |(other, count)| (index, other, count)))
            .filter(|(index, other, _)| index < other && border.is_left[*index] != border.is_left[*other])
            .map(|(_, _, count)| u64::from(count))
            .sum();
        border
    }

    /// Number of separated shared points, summed over pairs of images.
    pub(super) const fn cost(&self) -> u64 {
        self.cost
    }

    /// Left and right half, each in ascending order.
    pub(super) fn halves(&self) -> (Vec<u32>, Vec<u32>) {
        let side = |left: bool| {
            self.images.iter().zip(&self.is_left).filter(move |(_, is)| **is == left).map(|(image, _)| *image)
        };
        (side(true).collect(), side(false).collect())
    }

    /// Runs passes until one gives no improvement.
    pub(super) fn refined(mut self, sizes: &HalfSizes) -> Self {
        for _ in 0..MAX_PASSES {
            if !self.pass(sizes) {
                break;
            }
        }
        self
    }

    /// Runs one pass; returns whether it improved the border.
    fn pass(&mut self, sizes: &HalfSizes) -> bool {
        let mut gains: Vec<i64> = (0..self.images.len()).map(|index| self.gain(index)).collect();
        // An image without shared points never moves: moving it gains nothing.
        let shares = |index: &usize| self.neighbours(*index).next().is_some();
        let mut moves: [BinaryHeap<Move>; 2] = [false, true].map(|left| {
            let own = (0..gains.len()).filter(|index| self.is_left[*index] == left).filter(shares);
            own.map(|index| (gains[index], Reverse(index))).collect()
        });
        let mut is_moved = vec![false; self.images.len()];
        let mut left = self.is_left.iter().filter(|is| **is).count();
        let (mut saved, mut best, mut made, mut kept) = (0_i64, 0_i64, Vec::new(), 0);
        while made.len() - kept < MAX_FRUITLESS_MOVES.max(self.images.len() / 10) {
            // During an exchange, one side may exceed its limit by one.
            let may = [left <= sizes.max, left > 0 && left >= sizes.min];
            let next = [false, true].map(|from_left| {
                let heap = &mut moves[usize::from(from_left)];
                // Drop entries that were moved already or have an outdated gain.
                while heap.peek().is_some_and(|(gain, Reverse(p))| is_moved[*p] || gains[*p] != *gain) {
                    heap.pop();
                }
                heap.peek().copied().filter(|_| may[usize::from(from_left)])
            });
            // Ties go to the move towards the target size.
            let from_left = match next {
                [None, None] => break,
                [Some(_), None] => false,
                [None, Some(_)] => true,
                [Some((right_gain, _)), Some((left_gain, _))] if left_gain == right_gain => {
                    left > sizes.target
                }
                [Some((right_gain, _)), Some((left_gain, _))] => left_gain > right_gain,
            };
            let Some((gain, Reverse(index))) = moves[usize::from(from_left)].pop() else { break };
            is_moved[index] = true;
            self.is_left[index] = !from_left;
            left = if from_left { left - 1 } else { left + 1 };
            saved += gain;
            made.push(index);
            for (other, count) in self.neighbours(index).collect::<Vec<_>>() {
                let change = 2 * i64::from(count);
                gains[other] += if self.is_left[other] == self.is_left[index] { -change } else { change };
                if !is_moved[other] {
                    moves[usize::from(self.is_left[other])].push((gains[other], Reverse(other)));
                }
            }
            if saved > best && (sizes.min..=sizes.max).contains(&left) {
                (best, kept) = (saved, made.len());
            }
        }
        for index in &made[kept..] {
            self.is_left[*index] = !self.is_left[*index];
        }
        self.cost -= best.unsigned_abs();
        best > 0
    }

    /// Gain of moving an image to the other side; negative for a loss.
    fn gain(&self, index: usize) -> i64 {
        let of = |(other, count): (usize, u32)| {
            if self.is_left[other] == self.is_left[index] { -i64::from(count) } else { i64::from(count) }
        };
        self.neighbours(index).map(of).sum()
    }

    /// Neighbours by index in `images`.
    fn neighbours(&self, index: usize) -> impl Iterator<Item = (usize, u32)> {
        let among = |(other, count)| Some((self.images.binary_search(&other).ok()?, count));
        self.shared.neighbours(self.images[index]).filter_map(among)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cost, recomputed.
    fn recomputed_cost(border: &Border<'_>) -> u64 {
        Border::new(border.shared, border.images, &border.halves().0).cost()
    }

    #[test]
    fn sizes_respect_the_capacity_of_cores() {
        assert_eq!(HalfSizes::new(40, 1, 1, 20), HalfSizes { target: 20, min: 20, max: 20 });
        assert_eq!(HalfSizes::new(100, 1, 1, 80), HalfSizes { target: 50, min: 45, max: 55 });
        assert_eq!(HalfSizes::new(100, 1, 2, 34), HalfSizes { target: 33, min: 32, max: 34 });
        assert_eq!(HalfSizes::new(2, 1, 1, 1), HalfSizes { target: 1, min: 1, max: 1 });
        assert_eq!(HalfSizes::new(5, 2, 3, usize::MAX), HalfSizes { target: 2, min: 2, max: 2 });
    }

    /// Two interleaved clusters of ten: every intermediate border costs more, the final one nothing.
    #[test]
    fn refinement_leaves_local_minima() {
        let near =
            |image: u32| (0..20).filter(|o| *o != image && o % 2 == image % 2).map(|o| (o, 3)).collect();
        let shared = Covisibility::of_lists((0..20).map(near).collect());
        let images: Vec<u32> = (0..20).collect();
        let border = Border::new(&shared, &images, &images[..10]);
        assert_eq!(border.cost(), 2 * 25 * 3);
        let refined = border.refined(&HalfSizes::new(20, 1, 1, 10));
        assert_eq!((refined.cost(), recomputed_cost(&refined)), (0, 0));
        let (left, right) = refined.halves();
        assert_eq!((left.len(), right.len()), (10, 10));
    }

    #[test]
    fn cost_is_correct_and_never_rises() {
        let mut state = 7_u32;
        let mut number = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        for _ in 0..50 {
            let count = 2 + number(60);
            let lists = (0..count)
                .map(|image| {
                    let others =
                        (0..number(6)).map(|_| number(count)).collect::<std::collections::BTreeSet<_>>();
                    others.into_iter().filter(|o| *o != image).map(|other| (other, 1 + number(9))).collect()
                })
                .collect();
            let shared = Covisibility::of_lists(lists);
            let images: Vec<u32> = (0..count).collect();
            let sizes = HalfSizes::new(count as usize, 1, 1, count as usize);
            let begun = Border::new(&shared, &images, &images[..sizes.target]);
            let before = begun.cost();
            let refined = begun.refined(&sizes);
            assert_eq!(refined.cost(), recomputed_cost(&refined));
            assert!(refined.cost() <= before);
            let left = refined.halves().0.len();
            assert!((sizes.min..=sizes.max).contains(&left), "{left} {sizes:?}");
        }
    }
}
