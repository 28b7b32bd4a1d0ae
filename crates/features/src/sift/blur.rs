//! Gaussian blur, and the first level of the scale space, which doubles the image while it blurs it.
//!
//! Rows are independent and every sum has one fixed order, so results do not depend on the number of threads.
//! Outside the image its border samples go on for ever.

use std::array::from_fn;

use rayon::prelude::*;

use super::plane::{LANES, Plane};

/// Rows per unit of parallel work.
const ROWS: usize = 16;
/// Kernels end at this many standard deviations; 4 are slower and change no figure of docs/features.md by 0.3 %.
const CUT: f64 = 3.0;
/// No kernel of an octave reaches this far: the widest has a sigma of 3.1 samples.
const MAX_RADIUS: usize = 11;

/// The row under the centre of a kernel and those at 1, 2, ... steps from it, or one row seen from there.
type Rows<'a> = [&'a [f32]; MAX_RADIUS + 1];

/// Blurs `source` with a Gaussian of `sigma` pixels.
pub(super) fn blur(source: &Plane, sigma: f64, target: &mut Plane) {
    target.reshape(source.width, source.height);
    let half = half_kernel(sigma);
    let radius = half.len() - 1;
    let stride = target.stride;
    target.data.par_chunks_mut(stride * ROWS).enumerate().for_each(|(block, rows)| {
        let mut padded = vec![0.0; stride + 2 * radius];
        for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
            let y = (block * ROWS + i) as isize;
            let above: Rows = from_fn(|k| source.row_clamped(y - k as isize));
            let below: Rows = from_fn(|k| source.row_clamped(y + k as isize));
            symmetric_sum(&half, &above, &below, &mut padded[radius..radius + stride]);

            pad(&mut padded, radius, source.width);
            let left: Rows = from_fn(|k| &padded[radius - k.min(radius)..][..stride]);
            let right: Rows = from_fn(|k| &padded[radius + k.min(radius)..][..stride]);
            symmetric_sum(&half, &left, &right, row);
        }
    });
}

/// Doubles `source` and blurs it with a Gaussian of `sigma` *source* pixels, in one step.
///
/// Sample `u` of the result lies at `(u + 0.5) / 2 - 0.5` of the source: a quarter pixel left or right of a source
/// sample. The Gaussian is sampled there, so that no interpolation adds a blur of its own.
pub(super) fn double(source: &Plane, sigma: f64, target: &mut Plane) {
    target.reshape(2 * source.width, 2 * source.height);
    let phases = quarter_kernels(sigma);
    let radius = phases[0].len() / 2;
    let stride = target.stride;
    target.data.par_chunks_mut(stride * ROWS).enumerate().for_each(|(block, rows)| {
        let mut padded = vec![0.0; source.stride + 2 * radius];
        let mut halves = [vec![0.0; source.stride], vec![0.0; source.stride]];
        for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
            let y = block * ROWS + i;
            let reach = radius as isize;
            let near: Vec<&[f32]> =
                (-reach..=reach).map(|k| source.row_clamped((y / 2) as isize + k)).collect();
            weighted_sum(&phases[y % 2], &near, &mut padded[radius..radius + source.stride]);
            pad(&mut padded, radius, source.width);
            let near: Vec<&[f32]> = (0..=2 * radius).map(|k| &padded[k..][..source.stride]).collect();
            for (phase, half) in phases.iter().zip(&mut halves) {
                weighted_sum(phase, &near, half);
            }
            let [even, odd] = &halves;
            for ((pair, &left), &right) in row.chunks_exact_mut(2).zip(even).zip(odd) {
                pair[0] = left;
                pair[1] = right;
            }
        }
    });
}

/// `out = half[0] * before[0] + sum over k > 0 of half[k] * (before[k] + after[k])`; all rows as long as `out`.
fn symmetric_sum(half: &[f32], before: &Rows, after: &Rows, out: &mut [f32]) {
    for (chunk, out) in out.chunks_exact_mut(LANES).enumerate() {
        let range = chunk * LANES..(chunk + 1) * LANES;
        let mut sum = [0.0f32; LANES];
        for (sum, &sample) in sum.iter_mut().zip(&before[0][range.clone()]) {
            *sum = half[0] * sample;
        }
        for ((&weight, before), after) in half.iter().zip(before).zip(after).skip(1) {
            let (before, after) = (&before[range.clone()], &after[range.clone()]);
            for i in 0..LANES {
                sum[i] += weight * (before[i] + after[i]);
            }
        }
        out.copy_from_slice(&sum);
    }
}

/// `out = sum over k of weights[k] * rows[k]`; all rows as long as `out`.
fn weighted_sum(weights: &[f32], rows: &[&[f32]], out: &mut [f32]) {
    for (chunk, out) in out.chunks_exact_mut(LANES).enumerate() {
        let range = chunk * LANES..(chunk + 1) * LANES;
        let mut sum = [0.0f32; LANES];
        for (&weight, row) in weights.iter().zip(rows) {
            let row = &row[range.clone()];
            for i in 0..LANES {
                sum[i] += weight * row[i];
            }
        }
        out.copy_from_slice(&sum);
    }
}

/// Continues the `width` samples that start at `radius` to both ends of `padded`.
fn pad(padded: &mut [f32], radius: usize, width: usize) {
    let (first, last) = (padded[radius], padded[radius + width - 1]);
    padded[..radius].fill(first);
    padded[radius + width..].fill(last);
}

/// Weights of a Gaussian at 0, 1, 2, ... pixels from its centre; the whole kernel sums to 1.
fn half_kernel(sigma: f64) -> Vec<f32> {
    let radius = (CUT * sigma).ceil().clamp(1.0, MAX_RADIUS as f64) as usize;
    let weights: Vec<f64> = (0..=radius).map(|k| gaussian(k as f64, sigma)).collect();
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.iter().map(|w| (w / total) as f32).collect()
}

/// Kernels centred a quarter pixel left (first) and right (second) of their middle sample; each sums to 1.
fn quarter_kernels(sigma: f64) -> [Vec<f32>; 2] {
    let radius = (CUT * sigma + 0.25).ceil().max(1.0) as i32;
    [-0.25, 0.25].map(|centre| {
        let weights: Vec<f64> = (-radius..=radius).map(|k| gaussian(f64::from(k) - centre, sigma)).collect();
        let total: f64 = weights.iter().sum();
        weights.iter().map(|w| (w / total) as f32).collect()
    })
}

fn gaussian(x: f64, sigma: f64) -> f64 {
    (-x * x / (2.0 * sigma * sigma)).exp()
}
