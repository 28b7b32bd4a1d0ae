//! Layers of two images, pixel by pixel: what LPIPS and the distance of features have in common.

use veiloc_features::learned::Tensor;

/// Added to the length of a pixel's channels, as LPIPS has it.
const FLOOR: f32 = 1e-10;

/// Mean over pixels of what `weigh` makes of a pixel's channels of both images, each of length 1 (or of zeros). `a`, `b`:
/// `[1, C, h, w]`.
pub(crate) fn mean_over_pixels(a: &Tensor, b: &Tensor, weigh: impl Fn(&[f32], &[f32]) -> f64) -> f64 {
    let channels = a.shape.get(1).copied().unwrap_or(0);
    let pixels = a.data.len() / channels.max(1);
    let of = |tensor: &Tensor, pixel: usize, out: &mut Vec<f32>| {
        out.clear();
        out.extend(tensor.data.iter().skip(pixel).step_by(pixels));
        let length = out.iter().map(|v| v * v).sum::<f32>().sqrt() + FLOOR;
        for v in out.iter_mut() {
            *v /= length;
        }
    };
    let (mut own, mut other) = (Vec::new(), Vec::new());
    let mut sum = 0.0;
    for pixel in 0..pixels {
        of(a, pixel, &mut own);
        of(b, pixel, &mut other);
        sum += weigh(&own, &other);
    }
    sum / pixels.max(1) as f64
}
