//! Confidence intervals of a figure over many queries.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The middle 95 % of a figure over bootstrap samples; `None` for fewer than two values.
pub(super) fn interval(
    values: &[f64],
    figure: fn(&[f64]) -> f64,
    draws: usize,
    seed: u64,
) -> Option<(f64, f64)> {
    if values.len() < 2 || draws == 0 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn: Vec<f64> = (0..draws)
        .map(|_| {
            let sample: Vec<f64> =
                (0..values.len()).map(|_| values[rng.random_range(0..values.len())]).collect();
            figure(&sample)
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn[((share * draws as f64) as usize).min(draws - 1)];
    Some((at(0.025), at(0.975)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::metrics::mean;

    #[test]
    fn bootstrap_interval_of_a_mean_is_normal() {
        // 400 numbers with variance 1/12: the standard deviation of the mean is 0.01443, and the interval is ± 1.96
        // of it.
        let values: Vec<f64> = (0..400).map(|k| (f64::from(k) + 0.5) / 400.0).collect();
        let (low, high) = interval(&values, mean, 4000, 1).expect("values");
        let half = 1.96 * (1.0_f64 / 12.0 / 400.0).sqrt();
        assert!((low - (0.5 - half)).abs() < 0.002 && (high - (0.5 + half)).abs() < 0.002, "{low} {high}");
        assert_eq!(interval(&[1.0], mean, 100, 1), None);
        assert_eq!(interval(&[1.0, f64::INFINITY], mean, 100, 1).map(|i| i.1), Some(f64::INFINITY));
    }
}
