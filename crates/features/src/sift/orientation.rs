//! Dominant gradient directions around an extremum.

use std::f32::consts::{PI, TAU};

use super::gradient::GradientRow;
use super::plane::Plane;

/// Directions are counted in this many bins.
const BINS: usize = 36;
/// The window is a Gaussian this many times as wide as the extremum's own blur.
const WINDOW: f32 = 1.5;
/// A direction counts as dominant from this share of the strongest on.
const PEAK_SHARE: f32 = 0.8;
/// Rounds of smoothing over three bins.
const SMOOTHINGS: usize = 6;

/// Dominant directions, strongest first, at most `max`; from the column axis towards the row axis, in (-π, π].
///
/// `x`, `y` and `sigma` are in samples of `plane`. None where there is no gradient at all.
pub(super) fn dominant(
    plane: &Plane,
    [x, y]: [f32; 2],
    sigma: f32,
    max: usize,
    gradients: &mut GradientRow,
) -> Vec<f32> {
    smoothed_peaks(histogram(plane, [x, y], WINDOW * sigma, gradients), max)
}

fn histogram(plane: &Plane, [x, y]: [f32; 2], sigma: f32, gradients: &mut GradientRow) -> [f32; BINS] {
    let mut bins = [0.0f32; BINS];
    let reach = 3.0 * sigma;
    let (left, right) = inner_range(x, reach, plane.width);
    let (top, bottom) = inner_range(y, reach, plane.height);
    if left >= right {
        return bins;
    }
    let weight = |distance: f32| (-distance * distance / (2.0 * sigma * sigma)).exp();
    let column_weights: Vec<f32> = (left..right).map(|column| weight(column as f32 - x)).collect();
    for row in top..bottom {
        let dy = row as f32 - y;
        let row_weight = weight(dy);
        gradients.compute(plane, row, left, right);
        for (i, &column_weight) in column_weights.iter().enumerate() {
            let dx = (left + i) as f32 - x;
            if dx * dx + dy * dy > reach * reach {
                continue;
            }
            let vote = row_weight * column_weight * gradients.magnitude[i];
            // Shared by the two bins whose centres are nearest.
            let place = (gradients.angle[i] + PI) * (BINS as f32 / TAU) - 0.5 + BINS as f32;
            let whole = place as usize;
            let share = place - whole as f32;
            bins[whole % BINS] += (1.0 - share) * vote;
            bins[(whole + 1) % BINS] += share * vote;
        }
    }
    bins
}

fn smoothed_peaks(mut bins: [f32; BINS], max: usize) -> Vec<f32> {
    for _ in 0..SMOOTHINGS {
        let old = bins;
        for i in 0..BINS {
            bins[i] = (old[(i + BINS - 1) % BINS] + old[i] + old[(i + 1) % BINS]) / 3.0;
        }
    }
    let highest = bins.iter().copied().fold(0.0f32, f32::max);
    let mut peaks: Vec<(f32, f32)> = Vec::new();
    for i in 0..BINS {
        let (before, here, after) = (bins[(i + BINS - 1) % BINS], bins[i], bins[(i + 1) % BINS]);
        // Samples far outside of [0, 1] overflow: then there is no direction.
        if here > before && here >= after && here >= PEAK_SHARE * highest && here.is_finite() {
            let fraction = 0.5 * (before - after) / (before - 2.0 * here + after);
            let angle = (i as f32 + 0.5 + fraction) * (TAU / BINS as f32) - PI;
            peaks.push((here, if angle <= -PI { angle + TAU } else { angle }));
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(max);
    peaks.into_iter().map(|(_, angle)| angle).collect()
}

/// Samples within `reach` of `centre` along one axis that have neighbours on both sides, as a half-open range.
pub(super) fn inner_range(centre: f32, reach: f32, size: usize) -> (usize, usize) {
    let first = (centre - reach).ceil().max(1.0) as usize;
    let last = (centre + reach).floor().clamp(0.0, size as f32 - 2.0) as usize + 1;
    (first, last.max(first))
}
