//! How the errors of all attacks are spread: cumulative shares over a logarithmic axis, the guess dashed.

use std::fmt::Write as _;

use crate::format::escape;
use veiloc_evaluation::audit::Attack;

/// Ends of the axis, pixels.
const ENDS: (f64, f64) = (0.5, 1000.0);
/// Points of a curve.
const STEPS: usize = 96;
/// Colours there are; more attacks take them again.
const COLORS: usize = 8;

/// The drawing's own units.
const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 330.0;
const LEFT: f64 = 52.0;
const TOP: f64 = 14.0;
const BASE: f64 = 272.0;

/// A curve: an attack's name, its colour, and its errors in pixels.
pub(super) struct Curve<'a> {
    pub(super) attack: Attack,
    pub(super) color: usize,
    pub(super) guess: bool,
    pub(super) errors: &'a [f64],
}

/// Share of errors below each limit, 0 to 1; an error that is not a number is below none. Limits must rise.
pub(super) fn shares_below(errors: &[f64], limits: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = errors.iter().copied().filter(|e| !e.is_nan()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let below = |limit: &f64| sorted.partition_point(|e| e < limit) as f64 / errors.len().max(1) as f64;
    limits.iter().map(below).collect()
}

fn x_of(pixels: f64) -> f64 {
    let along = (pixels / ENDS.0).ln() / (ENDS.1 / ENDS.0).ln();
    LEFT + along.clamp(0.0, 1.0) * (WIDTH - LEFT - 14.0)
}

fn y_of(share: f64) -> f64 {
    BASE - share * (BASE - TOP)
}

/// The figure of one scheme.
pub(super) fn figure(title: &str, curves: &[Curve<'_>]) -> String {
    let mut drawn = String::new();
    for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let y = y_of(share);
        let _ = write!(
            drawn,
            "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{:.0} %</text>",
            WIDTH - 14.0,
            LEFT - 6.0,
            y + 4.0,
            100.0 * share
        );
    }
    for pixels in [1.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0] {
        let x = x_of(pixels);
        let _ = write!(
            drawn,
            "<path class=\"grid\" d=\"M{x:.1} {TOP}V{BASE}\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{pixels}</text>",
            BASE + 17.0
        );
    }
    let limits: Vec<f64> =
        (0..=STEPS).map(|k| ENDS.0 * (ENDS.1 / ENDS.0).powf(k as f64 / STEPS as f64)).collect();
    let mut legend = String::new();
    for curve in curves {
        let class = if curve.guess {
            "curve guessline".to_owned()
        } else {
            format!("curve k{}", curve.color % COLORS)
        };
        let mut path = String::new();
        for (limit, share) in limits.iter().zip(shares_below(curve.errors, &limits)) {
            let _ = write!(
                path,
                "{}{:.1} {:.1}",
                if path.is_empty() { 'M' } else { 'L' },
                x_of(*limit),
                y_of(share)
            );
        }
        let _ = write!(drawn, "<path class=\"{class}\" d=\"{path}\"/>");
        let _ = write!(
            legend,
            "<li><svg viewBox=\"0 0 24 12\" class=\"wide\" aria-hidden=\"true\"><path class=\"{class}\" d=\"M1 6H23\"/></svg>{}</li>",
            escape(curve.attack.words)
        );
    }
    format!(
        "<figure><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"Cumulative errors\">{drawn}\
         <path class=\"axis\" d=\"M{LEFT} {BASE}H{:.0}\"/><text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">error of a \
         recovered keypoint, pixels</text></svg><figcaption><b>{}.</b> Share of keypoints recovered to within an error; \
         farther left and higher is worse for whoever sent the query.<ul class=\"legend\">{legend}</ul></figcaption></figure>",
        WIDTH - 14.0,
        f64::midpoint(WIDTH, LEFT),
        BASE + 42.0,
        escape(title),
    )
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn shares_are_what_counting_says_and_rise() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut errors: Vec<f64> = (0..500).map(|_| 10f64.powf(rng.random_range(-1.0..3.5))).collect();
        errors.extend([f64::NAN, f64::INFINITY, 5.0, 5.0]);
        let limits = [0.5, 1.0, 5.0, 5.0000001, 30.0, 999.0, f64::INFINITY];
        let shares = shares_below(&errors, &limits);
        for (limit, share) in limits.iter().zip(&shares) {
            let counted = errors.iter().filter(|e| *e < limit).count() as f64 / errors.len() as f64;
            assert_eq!(*share, counted, "{limit}");
        }
        assert!(shares.windows(2).all(|w| w[0] <= w[1]) && shares[6] < 1.0, "{shares:?}");
        assert!((shares[3] - shares[2] - 2.0 / 504.0).abs() < 1e-12, "an error of 5 is not below 5");
        assert_eq!(shares_below(&[], &limits), [0.0; 7]);
    }

    #[test]
    fn a_curve_never_falls() {
        let errors = [0.1, 2.0, 40.0, 7.0, 1e6, f64::NAN];
        let page =
            figure("a <b>", &[Curve { attack: Attack::GRAPH, color: 0, guess: false, errors: &errors }]);
        let path = page.split("curve k0\" d=\"M").nth(1).and_then(|r| r.split('"').next()).expect("a curve");
        let heights: Vec<f64> = path
            .split('L')
            .map(|pair| pair.split(' ').nth(1).expect("two numbers").parse().expect("a number"))
            .collect();
        assert_eq!(heights.len(), STEPS + 1);
        // Up on the page is a smaller number.
        assert!(heights.windows(2).all(|w| w[1] <= w[0]), "{heights:?}");
        assert_eq!(heights[STEPS], (y_of(4.0 / 6.0) * 10.0).round() / 10.0);
        assert!(page.contains("a &lt;b&gt;") && !page.contains("NaN"), "{page}");
    }
}
