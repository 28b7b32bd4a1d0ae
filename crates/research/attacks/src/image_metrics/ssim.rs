//! Structural similarity.
//!
//! Wang et al., *Image Quality Assessment: From Error Visibility to Structural Similarity*, IEEE Transactions on
//! Image Processing 2004: a Gaussian window of 11 x 11 pixels, σ = 1.5.
//!
//! ```text
//! SSIM = (2 μa μb + C1) (2 σab + C2) / ((μa² + μb² + C1) (σa² + σb² + C2)),   C1 = (0.01 · 255)²,   C2 = (0.03 · 255)²
//! ```
//!
//! averaged over all windows that lie completely in the image, and over the three channels.

use crate::AttackError;
use crate::image_metrics::size::one_size;
use veiloc_features::ColourImage;

/// Pixels on either side of a window's middle.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 255.0 * 0.01 * 255.0;
const C2: f64 = 0.03 * 255.0 * 0.03 * 255.0;

/// Structural similarity, 1 for equal images.
///
/// # Errors
/// [`AttackError::Sizes`], and [`AttackError::Small`] when the image is smaller than a window.
pub fn ssim(a: &ColourImage, b: &ColourImage) -> Result<f64, AttackError> {
    let size = one_size(a, b)?;
    let least = 2 * RADIUS + 1;
    if size[0] < least || size[1] < least {
        return Err(AttackError::Small { size, least });
    }
    let window = window();
    let mut sum = 0.0;
    let mut count = 0;
    for colour in 0..3 {
        let [x, y] = [a, b].map(|image| {
            image.data().iter().skip(colour).step_by(3).map(|v| f64::from(*v)).collect::<Vec<f64>>()
        });
        let mean =
            |of: &dyn Fn(usize) -> f64| blurred(&(0..x.len()).map(of).collect::<Vec<f64>>(), size, &window);
        let (mean_x, mean_y) = (mean(&|i| x[i]), mean(&|i| y[i]));
        let (xx, yy, xy) = (mean(&|i| x[i] * x[i]), mean(&|i| y[i] * y[i]), mean(&|i| x[i] * y[i]));
        for i in 0..mean_x.len() {
            let (mx, my) = (mean_x[i], mean_y[i]);
            let (vx, vy, both) = (xx[i] - mx * mx, yy[i] - my * my, xy[i] - mx * my);
            sum += (2.0 * mx * my + C1) * (2.0 * both + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
        }
        count += mean_x.len();
    }
    Ok(sum / f64::from(count as u32))
}

/// `[11]`, normalised to sum 1.
fn window() -> Vec<f64> {
    let weight = |i: usize| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp();
    let all: Vec<f64> = (0..=2 * RADIUS).map(weight).collect();
    let whole: f64 = all.iter().sum();
    all.into_iter().map(|w| w / whole).collect()
}

/// Weighted means around each pixel whose window lies in the image, row by row.
fn blurred(image: &[f64], [width, height]: [usize; 2], window: &[f64]) -> Vec<f64> {
    let narrow = width - 2 * RADIUS;
    let sum = |values: &mut dyn Iterator<Item = f64>| values.zip(window).map(|(v, w)| v * w).sum::<f64>();
    let along: Vec<f64> = (image.chunks_exact(width))
        .flat_map(|row| (0..narrow).map(move |x| sum(&mut row[x..].iter().copied())))
        .collect();
    let down = |y: usize| {
        let along = &along;
        (0..narrow).map(move |x| sum(&mut along[y * narrow + x..].iter().copied().step_by(narrow)))
    };
    (0..height - 2 * RADIUS).flat_map(down).collect()
}
