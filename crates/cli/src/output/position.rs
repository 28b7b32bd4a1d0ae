//! Positions in text output.

use veiloc_report::significant;

/// The unit of lengths in a map's answers, for a map that knows it, and for one that does not.
pub(crate) const fn unit_of(is_metric: bool) -> &'static str {
    if is_metric { "m" } else { "units" }
}

/// `at (X, Y, Z) ± SD`, in map units: with as many decimals as the standard deviation justifies, at least three.
pub(crate) fn position([x, y, z]: [f64; 3], sd: f64) -> String {
    let wanted = if sd.is_finite() && sd > 0.0 { 1.0 - sd.log10().floor() } else { 3.0 };
    let decimals = wanted.clamp(3.0, 12.0) as usize;
    format!("at ({x:.decimals$}, {y:.decimals$}, {z:.decimals$}) ± {}", significant(sd))
}

#[cfg(test)]
mod tests {
    use super::position;

    #[test]
    fn decimals_follow_the_standard_deviation() {
        assert_eq!(position([1.0, -2.5, 0.125], 0.042), "at (1.000, -2.500, 0.125) ± 0.042");
        assert_eq!(position([1.5, 0.0, 1e4], 12.0), "at (1.500, 0.000, 10000.000) ± 12");
        assert_eq!(
            position([0.000_123_456, 0.0, -0.001], 0.000_002_1),
            "at (0.0001235, 0.0000000, -0.0010000) ± 2.1e-6"
        );
        assert_eq!(position([0.5, 0.0, 0.0], f64::INFINITY), "at (0.500, 0.000, 0.000) ± –");
    }
}
