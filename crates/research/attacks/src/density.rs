//! Spatial density of keypoints: a prior learned from other images.
//!
//! Keypoints are not spread evenly: skies and floors have few. An attacker who has seen other images knows this
//! density. The best answer along a segment is then the expected position under that density (times `r` for
//! half-lines, whose wedges widen; see [`crate::prior_only`]). Positions are counted relative to width and height, so
//! images of different size can be combined.

use veiloc_geometry::Pixel;

use crate::observation::Observation;
use crate::prior::{KnownSegment, mean};

const COLUMNS: usize = 48;
const ROWS: usize = 36;
/// Width of the smoothing kernel in cells.
const SMOOTHING: f64 = 1.5;
/// Points of a segment at which the density is evaluated.
const SAMPLES: usize = 256;

/// Histogram of keypoint positions in the image. Add the histograms of many images; subtract that of the attacked
/// image.
#[derive(Debug, Clone, PartialEq)]
pub struct KeypointHistogram {
    cells: Vec<f64>,
}

impl Default for KeypointHistogram {
    fn default() -> Self {
        Self { cells: vec![0.0; COLUMNS * ROWS] }
    }
}

impl KeypointHistogram {
    /// Histogram of one image's keypoints; keypoints outside the image are ignored.
    pub fn of(keypoints: &[Pixel], width: u32, height: u32) -> Self {
        let mut counts = Self::default();
        for p in keypoints {
            let (x, y) = (p.u / f64::from(width), p.v / f64::from(height));
            if (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y) {
                counts.cells[(y * ROWS as f64) as usize * COLUMNS + (x * COLUMNS as f64) as usize] += 1.0;
            }
        }
        counts
    }

    /// Adds the histogram of another image.
    pub fn add(&mut self, other: &Self) {
        self.cells.iter_mut().zip(&other.cells).for_each(|(a, b)| *a += b);
    }

    /// Subtracts the histogram of an image that was added.
    pub fn subtract(&mut self, other: &Self) {
        self.cells.iter_mut().zip(&other.cells).for_each(|(a, b)| *a = (*a - b).max(0.0));
    }

    /// The smoothed density of this histogram, mixed with a tenth of the uniform density.
    pub fn density(&self) -> Density {
        let across = smoothed(&self.cells, COLUMNS, ROWS);
        let transposed: Vec<f64> =
            (0..COLUMNS * ROWS).map(|k| across[(k % ROWS) * COLUMNS + k / ROWS]).collect();
        let down = smoothed(&transposed, ROWS, COLUMNS);
        let total: f64 = down.iter().sum();
        let even = if total > 0.0 { 0.1 } else { 1.0 } / (COLUMNS * ROWS) as f64;
        let learned = |k: usize| {
            if total > 0.0 { 0.9 * down[(k % COLUMNS) * ROWS + k / COLUMNS] / total } else { 0.0 }
        };
        Density { cells: (0..COLUMNS * ROWS).map(|k| learned(k) + even).collect() }
    }
}

/// Smooths along rows of `columns` cells, with reflection at the edges.
fn smoothed(cells: &[f64], columns: usize, rows: usize) -> Vec<f64> {
    let reach = (3.0 * SMOOTHING).ceil() as isize;
    let kernel: Vec<f64> = (-reach..=reach).map(|d| (-0.5 * (d as f64 / SMOOTHING).powi(2)).exp()).collect();
    let sum: f64 = kernel.iter().sum();
    let reflected = |at: isize| {
        let at = if at < 0 { -1 - at } else { at };
        (if at >= columns as isize { 2 * columns as isize - 1 - at } else { at }) as usize
    };
    let mut out = vec![0.0; cells.len()];
    for row in 0..rows {
        for column in 0..columns {
            for (d, w) in (-reach..=reach).zip(&kernel) {
                let at = reflected(column as isize + d);
                out[row * columns + column] += w / sum * cells[row * columns + at];
            }
        }
    }
    out
}

/// Probability density of keypoints over the image.
#[derive(Debug, Clone, PartialEq)]
pub struct Density {
    cells: Vec<f64>,
}

impl Density {
    fn at(&self, p: Pixel, width: u32, height: u32) -> f64 {
        let cell =
            |x: f64, size: u32, n: usize| ((x / f64::from(size) * n as f64).max(0.0) as usize).min(n - 1);
        self.cells[cell(p.v, height, ROWS) * COLUMNS + cell(p.u, width, COLUMNS)]
    }

    /// The expected distance from a segment's origin, and the likelihood of the segment up to one factor for the
    /// observation.
    fn expected(&self, segment: &KnownSegment, width: u32, height: u32) -> (f64, f64) {
        if segment.is_empty() {
            return (segment.expected(), 1.0);
        }
        let length = segment.far - segment.near;
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..SAMPLES {
            let t = segment.near + length * (k as f64 + 0.5) / SAMPLES as f64;
            let w = segment.likelihood(t) * self.at(segment.at(t), width, height);
            sum += w * t;
            weights += w;
        }
        let expected = if weights > 0.0 { sum / weights } else { segment.expected() };
        (expected, weights * length / SAMPLES as f64)
    }

    /// The expected position of each keypoint given its own observation and this density: as [`crate::expected_positions`],
    /// which assumes a uniform density.
    pub fn expected_positions(&self, observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
        let position = |o: &Observation| {
            mean(&KnownSegment::of(o, width, height), |segment| {
                let (expected, weight) = self.expected(segment, width, height);
                // A coin decides which of two lines was sent; the keypoint decides which span of one line.
                let share = if segment.anchor.is_some() { weight } else { segment.share };
                (segment.at(expected), share.max(f64::MIN_POSITIVE))
            })
        };
        observations.iter().map(position).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::errors_px;
    use crate::{expected_positions, lift};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::Pencils;

    fn clustered(n: usize, rng: &mut ChaCha8Rng) -> Vec<Pixel> {
        // Most keypoints in the lower third.
        (0..n)
            .map(|k| {
                let top = if k % 5 == 0 { 0.0 } else { 320.0 };
                Pixel::new(rng.random_range(0.0..640.0), rng.random_range(top..480.0))
            })
            .collect()
    }

    #[test]
    fn learned_density_beats_uniform_prior_and_uniform_density_equals_it() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = KeypointHistogram::of(&clustered(4000, &mut rng), 640, 480);
        let victim = clustered(1000, &mut rng);
        let own = KeypointHistogram::of(&victim, 640, 480);
        let before = counts.clone();
        counts.add(&own);
        counts.subtract(&own);
        assert_eq!(counts, before);
        let sent = lift::dual_convergent(&victim, &Pencils::paper(640, 480));
        let mean = |positions: Vec<Pixel>| errors_px(positions, &victim).iter().sum::<f64>() / 1000.0;
        let (learned, even) = (
            mean(counts.density().expected_positions(&sent, 640, 480)),
            mean(expected_positions(&sent, 640, 480)),
        );
        assert!(learned < 0.75 * even, "{learned} {even}");
        let nothing = KeypointHistogram::default().density().expected_positions(&sent, 640, 480);
        for (a, b) in nothing.iter().zip(expected_positions(&sent, 640, 480)) {
            assert!(a.distance(&b) < 1.0, "{a:?} {b:?}");
        }
    }
}
