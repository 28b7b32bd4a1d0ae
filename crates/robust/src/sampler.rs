//! Drawing correspondences: with probability proportional to a weight, from a generator the caller seeded.

use rand::Rng;

/// Draws indices of a list with given weights.
#[derive(Debug, Clone)]
pub(crate) struct WeightedSampler {
    indices: Vec<usize>,
    /// Running sums of the weights.
    cumulative: Vec<f64>,
}

impl WeightedSampler {
    /// Over the given indices; a weight that is not positive counts as the smallest positive number.
    pub(crate) fn new(entries: impl Iterator<Item = (usize, f64)>) -> Self {
        let mut sampler = Self { indices: Vec::new(), cumulative: Vec::new() };
        let mut sum = 0.0;
        for (index, weight) in entries {
            sum += if weight > 0.0 { weight } else { f64::MIN_POSITIVE };
            sampler.indices.push(index);
            sampler.cumulative.push(sum);
        }
        sampler
    }

    /// Sum of all weights.
    pub(crate) fn total(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    /// One index; `None` from an empty list.
    pub(crate) fn draw<R: Rng + ?Sized>(&self, rng: &mut R) -> Option<usize> {
        let target = rng.random::<f64>() * self.total();
        let at = self.cumulative.partition_point(|c| *c <= target);
        self.indices.get(at.min(self.indices.len().checked_sub(1)?)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

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
}
