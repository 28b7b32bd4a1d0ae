//! How errors are spread: the attack beside the guess.

use std::fmt::Write as _;

use super::format::percent;

/// Ends of the bins, pixels, and the colour class of each bin.
const ENDS: [f64; 6] = [5.0, 10.0, 30.0, 100.0, 300.0, f64::INFINITY];
const LABELS: [&str; 6] = ["&lt; 5", "5–10", "10–30", "30–100", "100–300", "≥ 300"];
const CLASS: [usize; 6] = [0, 1, 2, 3, 4, 4];

/// Bars of the share of keypoints per error bin; dashed outlines are the guess. Errors in pixels.
pub(super) fn figure(attack: &[f64], guess: &[f64]) -> String {
    let (attacked, guessed) = (shares(attack), shares(guess));
    let (width, height, left, base) = (460.0, 345.0, 44.0, 290.0);
    let step = (width - left - 16.0) / LABELS.len() as f64;
    let scale = (base - 26.0) / attacked.iter().chain(&guessed).copied().fold(0.05, f64::max);
    let mut bars = String::new();
    for k in 0..LABELS.len() {
        let x = left + step * k as f64;
        let (a, g) = (attacked[k] * scale, guessed[k] * scale);
        let _ = write!(
            bars,
            "<rect class=\"f{}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{a:.1}\" rx=\"2\"/>",
            CLASS[k],
            x + 7.0,
            base - a,
            step - 14.0
        );
        if !guess.is_empty() {
            let _ = write!(
                bars,
                "<rect class=\"guessbar\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{g:.1}\"/>",
                x + 3.0,
                base - g,
                step - 6.0
            );
        }
        let _ = write!(
            bars,
            "<text class=\"count\" x=\"{mid:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text x=\"{mid:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            base - a - 6.0,
            percent(Some(attacked[k])),
            base + 17.0,
            LABELS[k],
            mid = x + step / 2.0,
        );
    }
    let dashed = if guess.is_empty() { "" } else { " Dashed outlines: the guess from the single line." };
    format!(
        "<figure><svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"Histogram of recovery errors\">{bars}\
         <path class=\"axis\" d=\"M{left} {base}H{:.0}\"/><text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">error of a recovered \
         keypoint, pixels</text><text transform=\"translate(16 {:.0}) rotate(-90)\" text-anchor=\"middle\">share of keypoints\
         </text></svg><figcaption><b>How far off.</b> Numbers and solid bars: the attack.{dashed}</figcaption></figure>",
        width - 12.0,
        f64::midpoint(width, left),
        base + 40.0,
        base / 2.0 + 10.0,
    )
}

/// Share of the errors in each bin; what is not a number counts as the largest.
fn shares(errors: &[f64]) -> [f64; 6] {
    let mut counts = [0.0; 6];
    for e in errors {
        counts[ENDS.iter().position(|end| e < end).unwrap_or(5)] += 1.0 / errors.len() as f64;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_falls_into_a_bin() {
        let s = shares(&[0.0, 5.0, 29.9, 30.0, f64::INFINITY, f64::NAN, 99.0, 300.0]);
        assert_eq!(s, [0.125, 0.125, 0.125, 0.25, 0.0, 0.375]);
        assert!(figure(&[], &[]).contains("Histogram") && !figure(&[], &[]).contains("NaN"));
    }
}
