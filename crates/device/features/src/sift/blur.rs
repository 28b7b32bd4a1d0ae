//! The Gaussians of the scale space: how many, how wide, their weights.

use veiloc_simd::sift::{HalfKernel, MAX_RADIUS, exp2};

/// Scales per octave at which keypoints are searched.
pub(super) const SCALES: usize = 3;
/// Blurred images per octave: each scale needs a neighbour below and above among their differences.
pub(super) const LEVELS: usize = SCALES + 3;
/// Blur of the first level of an octave, in pixels of the octave.
pub(super) const FIRST_SIGMA: f64 = 1.6;
/// Kernels end at this many standard deviations; 4 are slower and change no value of docs/results/features.md by more than 0.3
/// %.
const CUT: f64 = 3.0;

/// Blur of a level, in pixels of its octave. Levels between the planes are allowed.
pub(super) fn sigma_of_level(level: f64) -> f64 {
    FIRST_SIGMA * exp2(level / SCALES as f64)
}

/// A Gaussian of `sigma` samples whose weights sum to 1. No kernel of an octave exceeds [`MAX_RADIUS`]: the widest has
/// a sigma of 3.1 samples.
pub(super) fn half_kernel(sigma: f64) -> HalfKernel {
    let radius = (CUT * sigma).ceil().clamp(1.0, MAX_RADIUS as f64) as usize;
    let weights: Vec<f64> = (0..=radius).map(|k| gaussian(k as f64, sigma)).collect();
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    HalfKernel::new(&weights.iter().map(|w| (w / total) as f32).collect::<Vec<_>>())
}

/// Kernels centred a quarter sample left (first) and right (second) of their middle sample; each sums to 1.
///
/// Sample `u` of a doubled image lies at `(u + 0.5) / 2 - 0.5` of the image: a quarter pixel left or right of a sample.
/// The Gaussian is sampled there, so that no interpolation adds further blur.
pub(super) fn quarter_kernels(sigma: f64) -> [Vec<f32>; 2] {
    let radius = (CUT * sigma + 0.25).ceil().max(1.0) as i32;
    [-0.25, 0.25].map(|centre| {
        let weights: Vec<f64> = (-radius..=radius).map(|k| gaussian(f64::from(k) - centre, sigma)).collect();
        let total: f64 = weights.iter().sum();
        weights.iter().map(|w| (w / total) as f32).collect()
    })
}

fn gaussian(x: f64, sigma: f64) -> f64 {
    exp2(-x * x / (2.0 * sigma * sigma) * std::f64::consts::LOG2_E)
}
