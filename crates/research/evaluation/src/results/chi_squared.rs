//! The chi-squared distribution of normalized squared errors.

use statrs::function::gamma::gamma_lr;

/// Probability that a chi-squared variable with this many degrees of freedom is at most `x`: the regularized lower
/// incomplete gamma function `P(k/2, x/2)`. 0 for `x ≤ 0`; NaN for NaN.
pub fn cumulative(degrees: u32, x: f64) -> f64 {
    match x {
        _ if x.is_nan() => f64::NAN,
        _ if x <= 0.0 => 0.0,
        _ if x.is_infinite() => 1.0,
        _ => gamma_lr(f64::from(degrees) / 2.0, x / 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_synthetic::problems::normal;

    /// For an even number of degrees the distribution is a finite sum: `1 − e^{−x/2} Σ_{i<k/2} (x/2)^i / i!`.
    #[test]
    fn even_degrees_equal_closed_form() {
        for degrees in [2, 4, 6, 10] {
            for x in [1e-3, 0.1, 1.0, 3.7, 5.348, 7.99, 8.01, 10.645, 16.812, 40.0] {
                let (mut term, mut sum) = (1.0, 1.0);
                for i in 1..degrees / 2 {
                    term *= x / 2.0 / f64::from(i);
                    sum += term;
                }
                let closed = 1.0 - (-x / 2.0_f64).exp() * sum;
                assert!((cumulative(degrees, x) - closed).abs() < 1e-12, "{degrees} {x}");
            }
        }
    }

    /// Quantiles from printed tables of the distribution.
    #[test]
    fn quantiles_equal_printed_tables() {
        for (degrees, x, p) in [
            (1, 3.841, 0.95),
            (3, 2.366, 0.50),
            (3, 6.251, 0.90),
            (3, 11.345, 0.99),
            (5, 9.236, 0.90),
            (6, 5.348, 0.50),
            (6, 10.645, 0.90),
            (6, 16.812, 0.99),
        ] {
            assert!((cumulative(degrees, x) - p).abs() < 2e-4, "{degrees} {x} {}", cumulative(degrees, x));
        }
    }

    #[test]
    fn sums_of_squared_normals_are_chi_squared() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let draws = 20_000;
        let below = (0..draws).filter(|_| {
            let squared: f64 = (0..3).map(|_| normal(&mut rng).powi(2)).sum();
            cumulative(3, squared) <= 0.9
        });
        let share = below.count() as f64 / f64::from(draws);
        assert!((share - 0.9).abs() < 0.008, "{share}");
    }

    #[test]
    fn limits_and_nan() {
        assert_eq!((cumulative(3, 0.0), cumulative(3, -1.0), cumulative(3, f64::INFINITY)), (0.0, 0.0, 1.0));
        assert!(cumulative(6, f64::NAN).is_nan());
        assert!(cumulative(6, 1e6) <= 1.0);
    }
}
