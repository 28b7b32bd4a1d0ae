//! Dominant gradient directions around an extremum.

use std::f32::consts::{PI, TAU};

use veiloc_simd::sift::BINS;

/// A direction is dominant from this share of the strongest on.
const PEAK_SHARE: f32 = 0.8;

/// Dominant directions, strongest first, at most `max`; from the column axis towards the row axis, in (-π, π].
///
/// `bins` are a full turn from -π on. Empty when there is no gradient.
pub(super) fn dominant(bins: &[f32; BINS], max: usize) -> Vec<f32> {
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
