//! The search loop: draw, solve, score, optimise locally, stop when further samples are unlikely to help (LO-RANSAC).
//!
//! The loop is generic over an [`Estimator`] and does not depend on cameras. The trait is split along the parts that
//! vary: `hypothesize` (sample and minimal solver), `cost` (score), `optimize` (refinement), and `hit_probability`
//! (probability of a right sample, which depends on the sampling weights).
//!
//! Chum, Matas and Kittler, *Locally Optimized RANSAC*, DAGM 2003; Lebeda, Matas and Chum, *Fixing the Locally
//! Optimized RANSAC*, BMVC 2012.

pub(crate) mod half_planes;
pub(crate) mod minimal;
mod radial;
pub(crate) mod sampler;

pub use veiloc_geometry::Stop;

use rand::Rng;

/// What the loop can estimate.
pub trait Estimator {
    /// The result of a minimal sample.
    type Model: Clone;

    /// Draws one minimal sample and appends the models it gives, none for a degenerate one.
    fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<Self::Model>);

    /// The model's cost, lower is better. May stop early with any value not below `best`. NaN counts as worst.
    fn cost(&self, model: &Self::Model, best: f64) -> f64;

    /// Probability that one sample consists of correspondences that agree with the model.
    fn hit_probability(&self, model: &Self::Model) -> f64;

    /// The best model near this one, and the cost by which such models are compared with each other: it may use more
    /// information than [`Self::cost`], and is then not lower.
    fn optimize<R: Rng + ?Sized>(
        &mut self,
        model: &Self::Model,
        cost: f64,
        rng: &mut R,
    ) -> (Self::Model, f64);

    /// Whether to stop the search; its result is then not used.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget {
    /// Least number of samples.
    pub min: usize,
    /// Largest number of samples.
    pub max: usize,
    /// Stop when the probability to have missed a right sample is below one minus this; 1 never stops early.
    pub confidence: f64,
}

impl Budget {
    /// Exactly this many samples.
    pub const fn fixed(samples: usize) -> Self {
        Self { min: samples, max: samples, confidence: 1.0 }
    }

    /// Samples needed at this probability of a right one.
    fn needed(&self, hit: f64) -> usize {
        if !(self.confidence < 1.0) {
            return self.max;
        }
        // Noise makes even right samples miss: PoseLib multiplies by three as well (dyn_num_trials_mult).
        let trials = 3.0 * (1.0 - self.confidence).ln() / (-hit.clamp(0.0, 1.0)).ln_1p();
        // A probability of zero gives infinity, a probability of one gives zero; the cast saturates.
        (trials.ceil() as usize).clamp(self.min, self.max)
    }
}

/// The result of the loop.
#[derive(Debug, Clone, PartialEq)]
pub struct RansacResult<M> {
    /// The best model; `None` when no sample gave one.
    pub model: Option<M>,
    /// Its cost; infinite without a model.
    pub cost: f64,
    /// Samples drawn.
    pub samples: usize,
    /// Models that were scored.
    pub models: usize,
    /// Local optimisations that were run.
    pub optimizations: usize,
}

/// Runs the search.
///
/// A model is optimised locally when it beats all models *as they came from a sample*. If it had to beat the optimised
/// ones, a strong early model would restrict the search to its neighbourhood.
pub fn lo_ransac<E: Estimator, R: Rng + ?Sized>(
    estimator: &mut E,
    budget: &Budget,
    rng: &mut R,
) -> RansacResult<E::Model> {
    let mut found =
        RansacResult { model: None, cost: f64::INFINITY, samples: 0, models: 0, optimizations: 0 };
    let mut best_sampled = f64::INFINITY;
    let mut needed = budget.max;
    let mut models = Vec::new();
    while found.samples < budget.max && (found.samples < budget.min || found.samples < needed) {
        if estimator.is_stopped() {
            break;
        }
        found.samples += 1;
        models.clear();
        estimator.hypothesize(rng, &mut models);
        for model in &models {
            found.models += 1;
            let cost = estimator.cost(model, best_sampled);
            if !(cost < best_sampled) {
                continue;
            }
            best_sampled = cost;
            found.optimizations += 1;
            let candidate = estimator.optimize(model, cost, rng);
            if candidate.1 < found.cost {
                needed = budget.needed(estimator.hit_probability(&candidate.0));
                found.cost = candidate.1;
                found.model = Some(candidate.0);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// The value on which most data points agree to 0.5; a sample is one data point. Counts the calls of the loop.
    struct Mock {
        data: Vec<f64>,
        sampled: Vec<f64>,
        optimized: usize,
        with_nan: bool,
    }

    impl Mock {
        fn new(inliers: usize, outliers: usize) -> Self {
            let data = (0..inliers)
                .map(|i| 10.0 + 0.3 * (i as f64 / inliers as f64 - 0.5))
                .chain((0..outliers).map(|i| 100.0 + 7.0 * i as f64))
                .collect();
            Self { data, sampled: Vec::new(), optimized: 0, with_nan: false }
        }

        fn agreeing(&self, model: f64) -> impl Iterator<Item = f64> + '_ {
            self.data.iter().copied().filter(move |d| (d - model).abs() < 0.5)
        }
    }

    impl Estimator for Mock {
        type Model = f64;

        fn hypothesize<R: Rng + ?Sized>(&mut self, rng: &mut R, models: &mut Vec<f64>) {
            let drawn = self.data[rng.random_range(0..self.data.len())];
            self.sampled.push(drawn);
            if self.with_nan {
                models.push(f64::NAN);
            }
            models.push(drawn);
        }

        fn cost(&self, model: &f64, _best: f64) -> f64 {
            if model.is_nan() {
                return f64::NAN;
            }
            self.data.iter().map(|d| ((d - model).powi(2) / 0.25).min(1.0)).sum()
        }

        fn hit_probability(&self, model: &f64) -> f64 {
            self.agreeing(*model).count() as f64 / self.data.len() as f64
        }

        fn optimize<R: Rng + ?Sized>(&mut self, model: &f64, _: f64, _: &mut R) -> (f64, f64) {
            self.optimized += 1;
            let mean = self.agreeing(*model).sum::<f64>() / self.agreeing(*model).count() as f64;
            (mean, self.cost(&mean, f64::INFINITY))
        }
    }

    fn run(mock: &mut Mock, budget: &Budget) -> RansacResult<f64> {
        lo_ransac(mock, budget, &mut ChaCha8Rng::seed_from_u64(7))
    }

    #[test]
    fn finds_the_consensus_and_stops_when_confident() {
        let budget = Budget { min: 5, max: 100_000, confidence: 0.9999 };
        for (inliers, outliers) in [(90, 10), (30, 70), (5, 95)] {
            let mut mock = Mock::new(inliers, outliers);
            let found = run(&mut mock, &budget);
            assert!((found.model.expect("found") - 10.0).abs() < 0.05);
            let hit = inliers as f64 / 100.0;
            let expected = (3.0 * (1e-4_f64).ln() / (1.0 - hit).ln()).ceil() as usize;
            assert!(
                found.samples.abs_diff(expected.max(5)) <= 1,
                "{inliers} of 100: {} {expected}",
                found.samples
            );
            assert_eq!(found.samples, mock.sampled.len());
        }
    }

    #[test]
    fn fixed_budget_is_exact() {
        for samples in [1, 17, 1000] {
            assert_eq!(run(&mut Mock::new(100, 0), &Budget::fixed(samples)).samples, samples);
        }
        let found = run(&mut Mock::new(0, 1), &Budget { min: 3, max: 50, confidence: 0.99 });
        assert_eq!(found.samples, 3, "one data point that always agrees");
    }

    #[test]
    fn optimizes_each_new_best_sample_once_and_no_other() {
        let mut mock = Mock::new(40, 60);
        let found = run(&mut mock, &Budget::fixed(500));
        let mut best = f64::INFINITY;
        let record_breaking = mock.sampled.iter().filter(|m| {
            let cost = mock.cost(m, f64::INFINITY);
            let breaks = cost < best;
            best = best.min(cost);
            breaks
        });
        assert_eq!(record_breaking.count(), mock.optimized);
        assert_eq!(found.optimizations, mock.optimized);
    }

    #[test]
    fn nan_costs_and_ties_are_ignored() {
        let plain = run(&mut Mock::new(20, 30), &Budget::fixed(200));
        let mut mock = Mock { with_nan: true, ..Mock::new(20, 30) };
        let with_nan = run(&mut mock, &Budget::fixed(200));
        assert_eq!(plain.model, with_nan.model);
        assert_eq!(plain.optimizations, with_nan.optimizations);
        // All data equal: the first of many ties is returned, and is optimised once.
        let mut ties = Mock::new(0, 0);
        ties.data = vec![1.0; 30];
        assert_eq!(run(&mut ties, &Budget::fixed(100)).optimizations, 1);
    }

    #[test]
    fn no_model_gives_no_result() {
        struct Empty;
        impl Estimator for Empty {
            type Model = ();
            fn hypothesize<R: Rng + ?Sized>(&mut self, _: &mut R, _: &mut Vec<()>) {}
            fn cost(&self, (): &(), _: f64) -> f64 {
                0.0
            }
            fn hit_probability(&self, (): &()) -> f64 {
                1.0
            }
            fn optimize<R: Rng + ?Sized>(&mut self, (): &(), cost: f64, _: &mut R) -> ((), f64) {
                ((), cost)
            }
        }
        let budget = Budget { min: 1, max: 30, confidence: 0.99 };
        let found = lo_ransac(&mut Empty, &budget, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!((found.model, found.samples), (None, 30));
    }
}
