//! Errors of recovered keypoints.

use veiloc_geometry::Pixel;
use veiloc_geometry::statistics::upper_median;

/// Distance of each recovered keypoint from the true one, pixels. Infinite if either is not finite.
pub fn errors_px(recovered: impl IntoIterator<Item = Pixel>, truth: &[Pixel]) -> Vec<f64> {
    recovered
        .into_iter()
        .zip(truth)
        .map(|(r, t)| {
            let d = r.distance(t);
            if d.is_nan() { f64::INFINITY } else { d }
        })
        .collect()
}

/// Summary of an attack's errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorSummary {
    /// Number of keypoints.
    pub count: usize,
    /// Mean error, pixels. NaN without keypoints. One answer far outside the image can dominate it.
    pub mean_px: f64,
    /// Median error, pixels. NaN without keypoints.
    pub median_px: f64,
    /// Share of keypoints with an error under 5 px, 0 to 1. NaN without keypoints.
    pub under_5px: f64,
    /// The same under 10 px.
    pub under_10px: f64,
    /// The same under 30 px.
    pub under_30px: f64,
}

impl ErrorSummary {
    /// The summary of these errors, pixels. NaN counts as infinite.
    pub fn of(errors: &[f64]) -> Self {
        let mut sorted: Vec<f64> =
            errors.iter().map(|e| if e.is_nan() { f64::INFINITY } else { *e }).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len();
        let share = |limit: f64| sorted.partition_point(|e| *e < limit) as f64 / n as f64;
        let median_px = match n {
            0 => f64::NAN,
            _ if n % 2 == 1 => sorted[n / 2],
            _ => f64::midpoint(sorted[n / 2 - 1], sorted[n / 2]),
        };
        Self {
            count: n,
            mean_px: sorted.iter().sum::<f64>() / n as f64,
            median_px,
            under_5px: share(5.0),
            under_10px: share(10.0),
            under_30px: share(30.0),
        }
    }
}

/// The upper median, 0 for an empty list: used as a scale.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    upper_median(&mut values).unwrap_or(0.0)
}

/// Mean information gain of an attack over the prior-only baseline, bits per keypoint.
///
/// The mean over keypoints of `log2(e_prior / e_attack)`. Both errors are clamped to 1 px (the accuracy of keypoints)
/// and to the image's diagonal (an answer outside the image can always be improved). One bit means that the attack
/// halves the error of the baseline; 0 means no gain; a negative value means that the attack is worse than the
/// baseline. NaN without keypoints.
pub fn bits_over_prior(attack_errors: &[f64], prior_errors: &[f64], width: u32, height: u32) -> f64 {
    let diagonal = f64::from(width).hypot(f64::from(height)).max(1.0);
    let held = |e: f64| if e.is_nan() { diagonal } else { e.clamp(1.0, diagonal) };
    let bits = attack_errors.iter().zip(prior_errors).map(|(a, p)| (held(*p) / held(*a)).log2());
    bits.sum::<f64>() / attack_errors.len().min(prior_errors.len()) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_and_bits_over_prior_match_hand_computation() {
        let s = ErrorSummary::of(&[4.0, 1.0, 40.0, 15.0]);
        assert_eq!((s.count, s.mean_px, s.median_px), (4, 15.0, 9.5));
        assert_eq!((s.under_5px, s.under_10px, s.under_30px), (0.5, 0.5, 0.75));
        assert_eq!(ErrorSummary::of(&[f64::NAN, 1.0, 2.0]).median_px, 2.0);
        assert!(ErrorSummary::of(&[]).median_px.is_nan());
        assert_eq!(bits_over_prior(&[2.0, 100.0], &[8.0, 100.0], 640, 480), 1.0);
        assert_eq!(bits_over_prior(&[0.0, f64::NAN], &[1.0, 800.0], 640, 480), 0.0);
        assert_eq!(bits_over_prior(&[64.0], &[16.0], 640, 480), -2.0);
    }

    #[test]
    fn missing_answer_has_infinite_error() {
        let e = errors_px([Pixel::new(f64::NAN, 0.0), Pixel::new(3.0, 4.0)], &[Pixel::new(0.0, 0.0); 2]);
        assert_eq!(e, [f64::INFINITY, 5.0]);
    }
}
