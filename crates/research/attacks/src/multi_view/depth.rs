//! Prior of the depth of an attacked keypoint: log-uniform within the scene's limits, with more weight at the depths
//! of nearby map points that the server sees.

use veiloc_geometry::Pixel;

/// Side of an image cell with one density, pixels.
const CELL: f64 = 16.0;
/// Number of depths at which a density is stored; it is interpolated between them.
const BINS: usize = 96;
/// Number of known points that contribute to a cell: the nearest ones.
const NEAREST: usize = 6;
/// Probability that a keypoint has the depth of known points around it, if they are near.
const TRUSTED: f64 = 0.6;
/// Spread of depth around a known point: relative, and per 100 px of distance from it.
const SPREAD: [f64; 2] = [0.03, 0.15];
/// Distance at which a known point has half its weight, pixels.
const REACH: f64 = 40.0;

/// Density of the log depth, by position in the attacked image.
pub(crate) struct DepthPrior {
    /// Logarithms of the limits.
    pub(crate) limits: [f64; 2],
    columns: usize,
    rows: usize,
    /// `[rows, columns, BINS]`, `None` without known points.
    density: Option<Vec<f64>>,
}

impl DepthPrior {
    /// `limits`: least and greatest depth; `known`: position and depth of map points in the attacked frame.
    pub(crate) fn new(limits: [f64; 2], known: &[(Pixel, f64)], width: u32, height: u32) -> Self {
        let limits = limits.map(f64::ln);
        let cells = |side: u32| (f64::from(side) / CELL).ceil().max(1.0) as usize;
        let (columns, rows) = (cells(width), cells(height));
        let inside = |z: f64| z.ln() >= limits[0] && z.ln() <= limits[1];
        let known: Vec<(Pixel, f64)> =
            known.iter().filter(|k| inside(k.1)).map(|(p, z)| (*p, z.ln())).collect();
        let length = limits[1] - limits[0];
        let density = (known.len() >= NEAREST && length > 0.0).then(|| {
            let center = |i: usize| (i as f64 + 0.5) * CELL;
            (0..rows * columns)
                .flat_map(|k| around(Pixel::new(center(k % columns), center(k / columns)), &known, limits))
                .collect()
        });
        Self { limits, columns, rows, density }
    }

    /// Longest step of the log depth that resolves the density.
    pub(crate) fn longest_step(&self) -> f64 {
        if self.density.is_some() { (self.limits[1] - self.limits[0]) / BINS as f64 } else { 0.25 }
    }

    /// The density at a position, `[BINS]`; `None` for the log-uniform one.
    pub(crate) fn at(&self, pixel: Pixel) -> Option<&[f64]> {
        let cell = |x: f64, count: usize| ((x / CELL).max(0.0) as usize).min(count - 1);
        let from = (cell(pixel.v, self.rows) * self.columns + cell(pixel.u, self.columns)) * BINS;
        self.density.as_ref().map(|d| &d[from..from + BINS])
    }

    /// Density of a log depth, from the values of [`Self::at`]; 1 if the limits are equal.
    pub(crate) fn density(&self, bins: Option<&[f64]>, log_depth: f64) -> f64 {
        let length = self.limits[1] - self.limits[0];
        let Some(bins) = bins else { return if length > 0.0 { 1.0 / length } else { 1.0 } };
        let at = ((log_depth - self.limits[0]) / length * BINS as f64 - 0.5).clamp(0.0, (BINS - 1) as f64);
        let low = (at as usize).min(BINS - 2);
        let share = at - low as f64;
        bins[low] * (1.0 - share) + bins[low + 1] * share
    }
}

impl DepthPrior {
    /// Median of the log depth at a position, and the variance of a Gaussian with the same entropy, which measures
    /// the information of a peaked density.
    pub(crate) fn median_and_variance(&self, pixel: Pixel) -> [f64; 2] {
        let [low, high] = self.limits;
        let length = (high - low).max(1e-9);
        let Some(bins) = self.at(pixel) else { return [f64::midpoint(low, high), length * length / 12.0] };
        let width = length / BINS as f64;
        let (mut sum, mut median, mut entropy) = (0.0, low, 0.0);
        for (b, density) in bins.iter().enumerate() {
            if sum < 0.5 {
                median = low + (b as f64 + 0.5) * width;
            }
            sum += density * width;
            entropy -= width * density * density.max(1e-300).ln();
        }
        [median, (2.0 * entropy - 1.0).exp() / (2.0 * std::f64::consts::PI)]
    }
}

/// The density at the centre of each bin, for one cell.
fn around(center: Pixel, known: &[(Pixel, f64)], limits: [f64; 2]) -> Vec<f64> {
    let length = limits[1] - limits[0];
    let mut near: Vec<(f64, f64)> = known.iter().map(|(p, s)| (p.distance(&center), *s)).collect();
    if near.len() > NEAREST {
        near.select_nth_unstable_by(NEAREST, |a, b| a.0.total_cmp(&b.0));
        near.truncate(NEAREST);
    }
    let weight = |distance: f64| 1.0 / (1.0 + (distance / REACH).powi(2));
    let total: f64 = near.iter().map(|n| weight(n.0)).sum();
    // Far from every known point only the scene's limits are used.
    let trusted = TRUSTED * (total / near.len().max(1) as f64).sqrt().min(1.0);
    let width = length / BINS as f64;
    let raw = |s: f64| {
        let one = |(distance, mean): &(f64, f64)| {
            let sigma = (SPREAD[0] + SPREAD[1] * distance / 100.0).max(width);
            weight(*distance) * (-0.5 * ((s - mean) / sigma).powi(2)).exp() / sigma
        };
        near.iter().map(one).sum::<f64>()
    };
    let shape: Vec<f64> = (0..BINS).map(|b| raw(limits[0] + (b as f64 + 0.5) * width)).collect();
    let sum: f64 = shape.iter().sum::<f64>() * width;
    shape.iter().map(|d| (1.0 - trusted) / length + if sum > 0.0 { trusted * d / sum } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_densities_are_normalized_and_follow_known_points() {
        let known: Vec<(Pixel, f64)> =
            (0..20).map(|i| (Pixel::new(f64::from(i) * 5.0, 50.0), 2.0 + f64::from(i) * 1e-3)).collect();
        let prior = DepthPrior::new([0.5, 20.0], &known, 640, 480);
        let none = DepthPrior::new([0.5, 20.0], &[], 640, 480);
        let sum = |prior: &DepthPrior, at: Pixel| {
            let bins = prior.at(at);
            let [low, high] = prior.limits;
            let step = (high - low) / 10_000.0;
            (0..10_000).map(|i| step * prior.density(bins, low + (f64::from(i) + 0.5) * step)).sum::<f64>()
        };
        for at in [Pixel::new(50.0, 50.0), Pixel::new(600.0, 400.0)] {
            assert!((sum(&prior, at) - 1.0).abs() < 0.01, "{}", sum(&prior, at));
            assert!((sum(&none, at) - 1.0).abs() < 1e-9);
        }
        let of = |prior: &DepthPrior, at: Pixel, z: f64| prior.density(prior.at(at), z.ln());
        let near = Pixel::new(50.0, 50.0);
        assert!(of(&prior, near, 2.0) > 10.0 * of(&prior, near, 8.0));
        assert!(of(&prior, near, 8.0) > 0.3 * of(&none, near, 8.0), "another depth stays possible");
        // Far from known points the density is nearly the log-uniform one.
        assert!(of(&prior, Pixel::new(600.0, 400.0), 8.0) > 0.8 * of(&none, near, 8.0));
    }
}
