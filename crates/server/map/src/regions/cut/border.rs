//! The border between two halves, moved to where few points are seen from both sides.
//!
//! Fiduccia and Mattheyses (1982): images change sides one at a time, the one that saves most (or costs least) first and
//! each once in a pass; of all borders on the way the best is taken. So a border gets over a hill that no single image
//! gets over. Passes go on until one finds nothing better.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::covisibility::Covisibility;

/// Passes at most; three or four are usual.
const PASSES: usize = 16;
/// A pass ends when so many moves in a row, and a tenth of the images, have led to nothing better.
const FRUITLESS: usize = 100;
/// Share of the smaller half that the sizes may be off for the sake of a better border.
const SLACK: f64 = 0.1;

/// How large the left half may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sizes {
    /// As large as its share of the regions.
    pub(super) target: usize,
    least: usize,
    most: usize,
}

impl Sizes {
    /// Of so many images for so many cores on the left and on the right, none of more than `core`.
    pub(super) fn new(images: usize, left: usize, right: usize, core: usize) -> Self {
        // What the cores can hold, and one image for each at least.
        let least = images.saturating_sub(right.saturating_mul(core)).max(left);
        let most = left.saturating_mul(core).min(images - right);
        let target = (images as f64 * left as f64 / (left + right) as f64).round() as usize;
        let target = target.clamp(least, most);
        let slack = (target.min(images - target) as f64 * SLACK) as usize;
        Self { target, least: least.max(target.saturating_sub(slack)), most: most.min(target + slack) }
    }
}

/// Two halves of some images.
pub(super) struct Border<'a> {
    shared: &'a Covisibility,
    images: &'a [u32],
    /// By place in `images`.
    is_left: Vec<bool>,
    cost: u64,
}

/// A move that may be made; the greatest saves most, of equals the image that comes first.
type Move = (i64, Reverse<usize>);

impl<'a> Border<'a> {
    /// Of images in rising order, some of which are left.
    pub(super) fn new(shared: &'a Covisibility, images: &'a [u32], left: &[u32]) -> Self {
        let mut is_left = vec![false; images.len()];
        for image in left {
            if let Ok(place) = images.binary_search(image) {
                is_left[place] = true;
            }
        }
        let mut border = Self { shared, images, is_left, cost: 0 };
        border.cost = (0..images.len())
            .flat_map(|place| border.neighbours(place).map(move |(other, count)| (place, other, count)))
            .filter(|(place, other, _)| place < other && border.is_left[*place] != border.is_left[*other])
            .map(|(_, _, count)| u64::from(count))
            .sum();
        border
    }

    /// Shared points that it parts, each pair of images by its own count.
    pub(super) const fn cost(&self) -> u64 {
        self.cost
    }

    /// Left and right, each in rising order.
    pub(super) fn halves(&self) -> (Vec<u32>, Vec<u32>) {
        let side = |left: bool| {
            self.images.iter().zip(&self.is_left).filter(move |(_, is)| **is == left).map(|(image, _)| *image)
        };
        (side(true).collect(), side(false).collect())
    }

    /// Moved until nothing better is found.
    pub(super) fn settled(mut self, sizes: &Sizes) -> Self {
        for _ in 0..PASSES {
            if !self.pass(sizes) {
                break;
            }
        }
        self
    }

    /// One pass; whether it found a better border.
    fn pass(&mut self, sizes: &Sizes) -> bool {
        let mut gains: Vec<i64> = (0..self.images.len()).map(|place| self.gain(place)).collect();
        // An image that shares nothing stays where it lies: moving it saves nothing.
        let shares = |place: &usize| self.neighbours(*place).next().is_some();
        let mut moves: [BinaryHeap<Move>; 2] = [false, true].map(|left| {
            let own = (0..gains.len()).filter(|place| self.is_left[*place] == left).filter(shares);
            own.map(|place| (gains[place], Reverse(place))).collect()
        });
        let mut is_moved = vec![false; self.images.len()];
        let mut left = self.is_left.iter().filter(|is| **is).count();
        let (mut saved, mut best, mut made, mut kept) = (0_i64, 0_i64, Vec::new(), 0);
        while made.len() - kept < FRUITLESS.max(self.images.len() / 10) {
            // While images are exchanged, one side has one more than it may keep.
            let may = [left <= sizes.most, left > 0 && left >= sizes.least];
            let next = [false, true].map(|from_left| {
                let heap = &mut moves[usize::from(from_left)];
                // What was moved, or stands there with an older gain, goes.
                while heap.peek().is_some_and(|(gain, Reverse(p))| is_moved[*p] || gains[*p] != *gain) {
                    heap.pop();
                }
                heap.peek().copied().filter(|_| may[usize::from(from_left)])
            });
            // Of equals the one that brings the sizes nearer to the target.
            let from_left = match next {
                [None, None] => break,
                [Some(_), None] => false,
                [None, Some(_)] => true,
                [Some((right_gain, _)), Some((left_gain, _))] if left_gain == right_gain => {
                    left > sizes.target
                }
                [Some((right_gain, _)), Some((left_gain, _))] => left_gain > right_gain,
            };
            let Some((gain, Reverse(place))) = moves[usize::from(from_left)].pop() else { break };
            is_moved[place] = true;
            self.is_left[place] = !from_left;
            left = if from_left { left - 1 } else { left + 1 };
            saved += gain;
            made.push(place);
            for (other, count) in self.neighbours(place).collect::<Vec<_>>() {
                let change = 2 * i64::from(count);
                gains[other] += if self.is_left[other] == self.is_left[place] { -change } else { change };
                if !is_moved[other] {
                    moves[usize::from(self.is_left[other])].push((gains[other], Reverse(other)));
                }
            }
            if saved > best && (sizes.least..=sizes.most).contains(&left) {
                (best, kept) = (saved, made.len());
            }
        }
        for place in &made[kept..] {
            self.is_left[*place] = !self.is_left[*place];
        }
        self.cost -= best.unsigned_abs();
        best > 0
    }

    /// Shared points that are saved when an image changes sides; negative when it costs some.
    fn gain(&self, place: usize) -> i64 {
        let of = |(other, count): (usize, u32)| {
            if self.is_left[other] == self.is_left[place] { -i64::from(count) } else { i64::from(count) }
        };
        self.neighbours(place).map(of).sum()
    }

    /// By place among the images that are halved.
    fn neighbours(&self, place: usize) -> impl Iterator<Item = (usize, u32)> {
        let among = |(other, count)| Some((self.images.binary_search(&other).ok()?, count));
        self.shared.neighbours(self.images[place]).filter_map(among)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cost counted anew.
    fn counted(border: &Border<'_>) -> u64 {
        Border::new(border.shared, border.images, &border.halves().0).cost()
    }

    #[test]
    fn sizes_stay_within_what_cores_hold() {
        assert_eq!(Sizes::new(40, 1, 1, 20), Sizes { target: 20, least: 20, most: 20 });
        assert_eq!(Sizes::new(100, 1, 1, 80), Sizes { target: 50, least: 45, most: 55 });
        assert_eq!(Sizes::new(100, 1, 2, 34), Sizes { target: 33, least: 32, most: 34 });
        assert_eq!(Sizes::new(2, 1, 1, 1), Sizes { target: 1, least: 1, most: 1 });
        assert_eq!(Sizes::new(5, 2, 3, usize::MAX), Sizes { target: 2, least: 2, most: 2 });
    }

    /// Two clusters of ten that were halved the wrong way: every border on the way costs more, the right one nothing.
    #[test]
    fn it_gets_over_a_hill() {
        let near =
            |image: u32| (0..20).filter(|o| *o != image && o % 2 == image % 2).map(|o| (o, 3)).collect();
        let shared = Covisibility::of_lists((0..20).map(near).collect());
        let images: Vec<u32> = (0..20).collect();
        let border = Border::new(&shared, &images, &images[..10]);
        assert_eq!(border.cost(), 2 * 25 * 3);
        let settled = border.settled(&Sizes::new(20, 1, 1, 10));
        assert_eq!((settled.cost(), counted(&settled)), (0, 0));
        let (left, right) = settled.halves();
        assert_eq!((left.len(), right.len()), (10, 10));
    }

    #[test]
    fn the_cost_is_what_it_says_and_never_rises() {
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
            let sizes = Sizes::new(count as usize, 1, 1, count as usize);
            let begun = Border::new(&shared, &images, &images[..sizes.target]);
            let before = begun.cost();
            let settled = begun.settled(&sizes);
            assert_eq!(settled.cost(), counted(&settled));
            assert!(settled.cost() <= before);
            let left = settled.halves().0.len();
            assert!((sizes.least..=sizes.most).contains(&left), "{left} {sizes:?}");
        }
    }
}
