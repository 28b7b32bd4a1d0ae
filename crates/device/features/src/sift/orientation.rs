//! Dominant gradient directions around an extremum.

use std::f32::consts::{PI, TAU};

use veiloc_simd::sift::BINS;

/// A direction is dominant from this share of the strongest on.
const PEAK_SHARE: f32 = 0.8;

/// Dominant directions, strongest first, at most `max`; from the column axis towards the row axis, in (-π, π].
///
/// `bins` are a full turn from -π on. None when there is no gradient. `peaks` is memory that calls may share.
pub(super) fn dominant<'a>(
    bins: &[f32; BINS],
    max: usize,
    peaks: &'a mut Vec<(f32, f32)>,
) -> impl Iterator<Item = f32> + use<'a> {
    let highest = bins.iter().copied().fold(0.0f32, f32::max);
    peaks.clear();
    for i in 0..BINS {
        let (before, here, after) = (bins[(i + BINS - 1) % BINS], bins[i], bins[(i + 1) % BINS]);
        // Samples far outside of [0, 1] overflow: then there is no direction.
        if here > before && here >= after && here >= PEAK_SHARE * highest && here.is_finite() {
            let fraction = 0.5 * (before - after) / (before - 2.0 * here + after);
            let angle = (i as f32 + 0.5 + fraction) * (TAU / BINS as f32) - PI;
            peaks.push((here, if angle <= -PI { angle + TAU } else { angle }));
        }
    }
    // At most half of the bins are peaks: sorted in place, without a buffer.
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.iter().take(max).map(|&(_, angle)| angle)
}
