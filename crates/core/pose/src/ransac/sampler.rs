//! Sampling of correspondences with probability proportional to a weight, from a generator that the caller seeded.

use crate::solvers::ArrayVec;
use rand::Rng;

use crate::likelihood::Matches;

/// Maximum number of draws for a sample of distinct correspondences.
const MAX_DRAWS: usize = 64;

/// Draws indices of a list with given weights.
#[derive(Debug, Clone)]
pub(crate) struct WeightedSampler {
    indices: Vec<usize>,
    /// Running sums of the weights.
    cumulative: Vec<f64>,
    squares: f64,
}

impl WeightedSampler {
    /// A sampler of the given indices; a weight that is not positive counts as the smallest positive number.
    pub(crate) fn new(entries: impl Iterator<Item = (usize, f64)>) -> Self {
        let mut sampler = Self { indices: Vec::new(), cumulative: Vec::new(), squares: 0.0 };
        let mut sum = 0.0;
        for (index, weight) in entries {
            sum += if weight > 0.0 { weight } else { f64::MIN_POSITIVE };
            sampler.squares += weight * weight;
            sampler.indices.push(index);
            sampler.cumulative.push(sum);
        }
        sampler
    }

    /// Sum of all weights.
    pub(crate) fn total(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.indices.len()
    }

    /// Probability that a drawn entry is right, if each weight is the probability that its entry is right.
    pub(crate) fn expected_share(&self) -> f64 {
        if self.total() > 0.0 { self.squares / self.total() } else { 0.0 }
    }

    /// One index; `None` from an empty list.
    pub(crate) fn draw<R: Rng + ?Sized>(&self, rng: &mut R) -> Option<usize> {
        let target = rng.random::<f64>() * self.total();
        let at = self.cumulative.partition_point(|c| *c <= target);
        self.indices.get(at.min(self.indices.len().checked_sub(1)?)).copied()
    }
}

/// Draws an index from shares that sum to 1; `None` when there is none.
pub(crate) fn pick<R: Rng + ?Sized>(rng: &mut R, shares: impl Iterator<Item = f64>) -> Option<usize> {
    let mut target = rng.random::<f64>();
    let mut last = None;
    for (k, share) in shares.enumerate().filter(|(_, share)| *share > 0.0) {
        last = Some(k);
        target -= share;
        if target < 0.0 {
            break;
        }
    }
    last
}

/// Samples of `size` from two lists, never all from one: the number from the first list is drawn in proportion to the
/// probability that all entries are right.
#[derive(Debug, Clone)]
pub(crate) struct SplitSampler {
    sides: [WeightedSampler; 2],
    size: usize,
    /// Probability of each split, by the number drawn from the first list, `[size + 1]`; they sum to 1 or are all 0.
    chances: Vec<f64>,
}

impl SplitSampler {
    /// Over two lists whose weights are probabilities of being right.
    pub(crate) fn new(sides: [WeightedSampler; 2], size: usize) -> Self {
        let share = [0, 1].map(|s| sides[s].expected_share());
        let chance = |k: usize| {
            let possible = k >= 1 && k < size && k <= sides[0].len() && size - k <= sides[1].len();
            if possible { share[0].powi(k as i32) * share[1].powi((size - k) as i32) } else { 0.0 }
        };
        let chances: Vec<f64> = (0..=size).map(chance).collect();
        let total: f64 = chances.iter().sum();
        let chances = chances.into_iter().map(|c| if total > 0.0 { c / total } else { 0.0 }).collect();
        Self { sides, size, chances }
    }

    /// The number of entries of the next sample from the first list; `None` when no split is possible.
    pub(crate) fn draw_split<R: Rng + ?Sized>(&self, rng: &mut R) -> Option<usize> {
        pick(rng, self.chances.iter().copied())
    }

    /// The list of the next entry when `drawn` entries are already drawn.
    pub(crate) fn side(&self, split: usize, drawn: usize) -> &WeightedSampler {
        &self.sides[usize::from(drawn >= split)]
    }

    /// Probability that all entries of a sample agree, for this total weight of agreeing entries per list.
    pub(crate) fn hit_probability(&self, agreeing: [f64; 2]) -> f64 {
        let share = [0, 1].map(|s| agreeing[s] / self.sides[s].total().max(f64::MIN_POSITIVE));
        let of_split = |(k, chance): (usize, &f64)| {
            chance * share[0].powi(k as i32) * share[1].powi((self.size - k) as i32)
        };
        self.chances.iter().enumerate().map(of_split).sum()
    }
}

/// `K` correspondences, no two with the same keypoint or the same map point: at most one of such a pair is right.
///
/// Map points are identified by their coordinates: two points with equal coordinates constrain a pose as one.
///
/// `next` gets the number of entries that are already drawn.
pub(crate) fn draw<const K: usize, R: Rng + ?Sized>(
    matches: &Matches<'_>,
    rng: &mut R,
    mut next: impl FnMut(&mut R, usize) -> Option<usize>,
) -> Option<[usize; K]> {
    let mut sample: ArrayVec<usize, K> = ArrayVec::new();
    for _ in 0..MAX_DRAWS {
        let i = next(rng, sample.len())?;
        let clash = sample
            .iter()
            .any(|&j| matches.keypoint[i] == matches.keypoint[j] || matches.points[i] == matches.points[j]);
        if !clash {
            sample.push(i);
            if sample.is_full() {
                return sample.into_inner().ok();
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::{Correspondences, PoseProblem};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::{Pinhole, Pixel, PixelLine, Point3};

    #[test]
    fn frequencies_follow_the_weights() {
        let weights = [0.5, 0.0, 2.0, 1.5];
        let sampler = WeightedSampler::new(weights.iter().copied().enumerate().map(|(i, w)| (i + 10, w)));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = [0_usize; 4];
        for _ in 0..40_000 {
            counts[sampler.draw(&mut rng).expect("not empty") - 10] += 1;
        }
        for (count, weight) in counts.iter().zip(weights) {
            assert!((*count as f64 / 10_000.0 - weight).abs() < 0.06, "{counts:?}");
        }
        assert_eq!(WeightedSampler::new(std::iter::empty()).draw(&mut rng), None);
    }

    #[test]
    fn split_frequencies_and_hit_probability_are_correct() {
        // Two of three and three of nine are right; weights match this only on average.
        let list =
            |from: usize, n: usize, weight: f64| WeightedSampler::new((from..from + n).map(|i| (i, weight)));
        let split = SplitSampler::new([list(0, 3, 0.6), list(10, 9, 0.3)], 4);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut counts, mut hits) = ([0_usize; 5], 0);
        let rounds = 200_000;
        for _ in 0..rounds {
            let k = split.draw_split(&mut rng).expect("possible");
            counts[k] += 1;
            let right = (0..4).all(|drawn| {
                let i = split.side(k, drawn).draw(&mut rng).expect("not empty");
                i < 2 || (10..13).contains(&i)
            });
            hits += usize::from(right);
        }
        assert_eq!((counts[0], counts[4]), (0, 0));
        for k in 1..3 {
            let ratio = counts[k + 1] as f64 / counts[k] as f64;
            assert!((ratio - 2.0).abs() < 0.1, "{counts:?}");
        }
        let expected = split.hit_probability([2.0 * 0.6, 3.0 * 0.3]);
        assert!((hits as f64 / f64::from(rounds) - expected).abs() < 0.003, "{hits} {expected}");
        // One list too short for any split, or empty.
        assert_eq!(SplitSampler::new([list(0, 0, 1.0), list(10, 9, 0.3)], 4).draw_split(&mut rng), None);
    }

    /// Pixels seen exactly from the identity pose, each proposed for two map points and sent as one line.
    fn proposed_twice(lines: [f64; 3], keypoints: [usize; 6]) -> PoseProblem {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0; 2], principal: [320.0, 240.0] };
        let pixel = |i: usize| Pixel::new(100.0, 100.0 + 40.0 * i as f64);
        let lines = (0..6).map(|i| PixelLine::through(pixel(0), lines[i / 2])).collect();
        let points = (0..6).map(|i| Point3::new(0.1 * i as f64, 0.3, 2.0)).collect();
        PoseProblem::new(camera, Correspondences::Lines { lines }, keypoints.into(), points)
    }

    #[test]
    fn samples_have_distinct_keypoints() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let all = WeightedSampler::new((0..6).map(|i| (i, 1.0)));
        let mut sample = |problem: &PoseProblem| {
            let matches = Matches::new(problem, 0.5);
            draw::<3, _>(&matches, &mut rng, |rng, _| all.draw(rng))
        };
        // The two lines of a keypoint differ, as in coordinate permutation.
        let mut two_lines = proposed_twice([0.1, 0.2, 0.3], [7, 7, 5, 5, 6, 6]);
        if let Correspondences::Lines { lines } = &mut two_lines.observations {
            lines[1] = lines[2];
            lines[3] = lines[4];
            lines[5] = lines[0];
        }
        for _ in 0..200 {
            let drawn = sample(&two_lines).expect("three keypoints");
            let mut keypoints = drawn.map(|i| two_lines.keypoints[i]);
            keypoints.sort_unstable();
            assert_eq!(keypoints, [5, 6, 7]);
        }
        // One code for all six: still six keypoints.
        let one_code = proposed_twice([0.1; 3], [0, 1, 2, 3, 4, 5]);
        assert!(sample(&one_code).is_some());
        // Six different map points, but two keypoints: no sample of three.
        assert_eq!(sample(&proposed_twice([0.1, 0.2, 0.3], [0, 0, 0, 1, 1, 1])), None);
        let mut one_place = one_code;
        one_place.points = vec![one_place.points[0]; 6];
        assert_eq!(sample(&one_place), None);
    }
}
