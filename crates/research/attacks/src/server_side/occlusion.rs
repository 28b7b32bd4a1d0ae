//! The occlusion in the map: a server that has the pose knows where points of its map should have been seen and were not.
//! Something stands there, and rows that no map point explains lie there.
//!
//! Two densities are compared: points that nearby map images saw, projected into the query, and those of them that an
//! inlier confirms. A region of area `A` that hides the map has the log likelihood ratio of two Poisson counts,
//! `Σ_A [S ln ε + (1 − ε) ρ E]`, with `E` expected and `S` confirmed points in a cell, the rate `ρ` at which points are
//! confirmed in the rest of the image, and the share `ε` of wrong inliers. The regions are upright ellipses of all positions and some
//! sizes, as a person is. The lines of the rows that remain decide between the best regions: more of them pass through
//! the true one. Both are tempered, because neighbouring points and rows are not independent.

use veiloc_geometry::Pixel;

use crate::observation::Observation;
use crate::prior::{KnownSegment, prior_only};

/// What the map should show and shows in a query, projected with its pose: `[E]` and `[C]`, pixels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapVisibility {
    /// Map points that images near the query saw.
    pub expected: Vec<Pixel>,
    /// Map points that inliers of the query confirm.
    pub confirmed: Vec<Pixel>,
}

/// Answers of [`occlusion`], `[N]`.
#[derive(Debug, Clone, PartialEq)]
pub struct OcclusionEstimate {
    /// The recovered keypoints, as if all of them were in the occlusion.
    pub pixels: Vec<Pixel>,
    /// Probability that a row lies in the occlusion, 0 to 1; 0 for known positions.
    pub inside: Vec<f64>,
}

/// Cells across the longer side of the image.
const CELLS: f64 = 64.0;
/// Half heights of the regions, relative to the image's height.
const HALF_HEIGHTS: [f64; 5] = [0.08, 0.12, 0.18, 0.26, 0.36];
/// Height over width of a region.
const UPRIGHT: f64 = 2.5;
/// Share of wrong inliers.
const WRONG: f64 = 0.05;
/// The confirmed rate outside of the occlusion is larger than that of the whole image.
const RATE_OUTSIDE: f64 = 1.15;
/// Exponents of both likelihoods.
const TEMPER_POINTS: f64 = 0.3;
const TEMPER_ROWS: f64 = 0.03;
/// Regions that the rows decide between.
const REGIONS: usize = 200;
/// Positions at which a line is evaluated.
const SAMPLES: usize = 128;
/// Share of the unexplained rows in the occlusion: start of its estimation, and steps.
const SHARE: f64 = 0.25;
const SHARE_STEPS: usize = 6;
/// Weight of positions outside all regions.
const WEIGHT_OUTSIDE: f64 = 1e-3;
/// Density of unexplained rows outside of the occlusion: as expected points, smoothed over this many cells, or uniform.
const SMOOTHING: f64 = 1.5;
const UNIFORM: f64 = 0.3;

/// Recovers rows that no map point explains (all but [`Observation::Known`]) as keypoints of something that hides the
/// map.
///
/// Without expected points the answers are those of [`prior_only`].
pub fn occlusion(
    observations: &[Observation],
    map: &MapVisibility,
    width: u32,
    height: u32,
) -> OcclusionEstimate {
    let mut answers = OcclusionEstimate {
        pixels: prior_only(observations, width, height),
        inside: vec![0.0; observations.len()],
    };
    let grid = Grid::new(width, height);
    let expected = grid.counts(&map.expected);
    let total: f64 = expected.iter().sum();
    if total <= 0.0 {
        return answers;
    }
    let confirmed = grid.counts(&map.confirmed);
    let rate = RATE_OUTSIDE * confirmed.iter().sum::<f64>() / total;
    let ratio: Vec<f64> =
        expected.iter().zip(&confirmed).map(|(e, s)| s * WRONG.ln() + (1.0 - WRONG) * rate * e).collect();
    let rows: Vec<(usize, Row)> = observations
        .iter()
        .enumerate()
        .filter(|(_, o)| !matches!(o, Observation::Known(_)))
        .filter_map(|(i, o)| Some((i, grid.row(o, width, height)?)))
        .collect();
    let background = grid.background(&expected);
    let outside: Vec<f64> = rows.iter().map(|(_, row)| row.sum(&background)).collect();

    let regions = grid.regions(&ratio);
    let (mut weights, mut insides) = (Vec::new(), Vec::new());
    for region in &regions {
        let within: Vec<f64> =
            rows.iter().map(|(_, row)| row.sum_in(region) / region.cells.len() as f64).collect();
        let mut share = SHARE;
        let mut inside = Vec::new();
        for _ in 0..SHARE_STEPS {
            inside = within.iter().zip(&outside).map(|(h, b)| probability(share, *h, *b)).collect();
            share = (inside.iter().sum::<f64>() / inside.len().max(1) as f64).clamp(0.005, 0.9);
        }
        let gain = |(h, b): (&f64, &f64)| (1.0 - share + share * h / b).max(1e-12).ln();
        let of_rows: f64 = within.iter().zip(&outside).map(gain).sum();
        weights.push(TEMPER_POINTS * region.log_ratio + TEMPER_ROWS * of_rows);
        insides.push(inside);
    }
    let best = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    for weight in &mut weights {
        *weight = (*weight - best).exp();
    }
    let sum: f64 = weights.iter().sum();
    let mut occupied = vec![0.0; grid.columns * grid.rows];
    for ((region, inside), weight) in regions.iter().zip(&insides).zip(&weights) {
        region.cells.iter().for_each(|cell| occupied[*cell] += weight / sum);
        for ((i, _), inside) in rows.iter().zip(inside) {
            answers.inside[*i] += inside * weight / sum;
        }
    }
    for (i, row) in &rows {
        answers.pixels[*i] = row.median(&occupied);
    }
    answers
}

/// Probability that a row is in the occlusion, for the densities of its line inside and outside.
fn probability(share: f64, inside: f64, outside: f64) -> f64 {
    let inside = share * inside;
    inside / (inside + (1.0 - share) * outside).max(f64::MIN_POSITIVE)
}

/// Cells over the image.
struct Grid {
    side: f64,
    columns: usize,
    rows: usize,
}

/// A region that may hide the map.
struct Region {
    cells: Vec<usize>,
    log_ratio: f64,
}

/// Positions of one row along its likeliest line, in order, with their cells and probabilities.
struct Row {
    samples: Vec<(Pixel, usize, f64)>,
}

impl Grid {
    fn new(width: u32, height: u32) -> Self {
        let side = (f64::from(width.max(height)) / CELLS).max(1.0);
        let count = |length: u32| ((f64::from(length) / side).ceil() as usize).max(1);
        Self { side, columns: count(width), rows: count(height) }
    }

    fn cell(&self, p: Pixel) -> Option<usize> {
        let (column, row) = ((p.u / self.side).floor(), (p.v / self.side).floor());
        let inside =
            column >= 0.0 && row >= 0.0 && (column as usize) < self.columns && (row as usize) < self.rows;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    fn counts(&self, pixels: &[Pixel]) -> Vec<f64> {
        let mut counts = vec![0.0; self.columns * self.rows];
        pixels.iter().filter_map(|p| self.cell(*p)).for_each(|cell| counts[cell] += 1.0);
        counts
    }

    /// Probability of each cell for a row outside of the occlusion.
    fn background(&self, expected: &[f64]) -> Vec<f64> {
        let reach = (3.0 * SMOOTHING).ceil() as isize;
        let smooth = |from: &[f64], step: isize, count: usize, index: &dyn Fn(usize) -> usize| -> Vec<f64> {
            (0..from.len())
                .map(|cell| {
                    (-reach..=reach)
                        .filter_map(|d| {
                            let at = index(cell) as isize + d;
                            let inside = at >= 0 && at < count as isize;
                            let weight = (-0.5 * (d as f64 / SMOOTHING).powi(2)).exp();
                            inside.then(|| weight * from[(cell as isize + d * step) as usize])
                        })
                        .sum()
                })
                .collect()
        };
        let across = smooth(expected, 1, self.columns, &|cell| cell % self.columns);
        let density = smooth(&across, self.columns as isize, self.rows, &|cell| cell / self.columns);
        let total: f64 = density.iter().sum();
        let uniform = UNIFORM / density.len() as f64;
        density.iter().map(|d| uniform + (1.0 - UNIFORM) * d / total).collect()
    }

    /// The regions that hide the map most probably, best first.
    fn regions(&self, ratio: &[f64]) -> Vec<Region> {
        let mut found: Vec<(f64, usize, f64)> = Vec::new();
        for half_height in HALF_HEIGHTS {
            for center in 0..self.columns * self.rows {
                let log_ratio = self.ellipse(center, half_height).map(|cell| ratio[cell]).sum();
                found.push((log_ratio, center, half_height));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.truncate(REGIONS);
        let region = |(log_ratio, center, half_height): (f64, usize, f64)| Region {
            cells: self.ellipse(center, half_height).collect(),
            log_ratio,
        };
        found.into_iter().map(region).collect()
    }

    /// Cells of an upright ellipse about the middle of a cell.
    fn ellipse(&self, center: usize, half_height: f64) -> impl Iterator<Item = usize> + use<'_> {
        let tall = half_height * self.rows as f64;
        let (column, row) = ((center % self.columns) as f64, (center / self.columns) as f64);
        let range = |at: f64, reach: f64, count: usize| {
            (at - reach).ceil().max(0.0) as usize..=((at + reach).floor() as usize).min(count - 1)
        };
        range(row, tall, self.rows).flat_map(move |y| {
            let wide = (1.0 - ((y as f64 - row) / tall).powi(2)).max(0.0).sqrt() * tall / UPRIGHT;
            range(column, wide, self.columns).map(move |x| y * self.columns + x)
        })
    }

    /// `None` when the line misses the image.
    fn row(&self, observation: &Observation, width: u32, height: u32) -> Option<Row> {
        let segments = KnownSegment::of(observation, width, height);
        let mut samples = Vec::new();
        for segment in segments.iter().filter(|segment| !segment.is_empty()) {
            let length = segment.far - segment.near;
            let at = |k: usize| segment.near + length * (k as f64 + 0.5) / SAMPLES as f64;
            let mass: f64 = (0..SAMPLES).map(|k| segment.likelihood(at(k))).sum();
            for t in (0..SAMPLES).map(at) {
                let pixel = segment.at(t);
                let Some(cell) = self.cell(pixel) else { continue };
                let weight = if mass > 0.0 { segment.likelihood(t) / mass } else { 1.0 / SAMPLES as f64 };
                samples.push((pixel, cell, segment.share * weight));
            }
        }
        (!samples.is_empty()).then_some(Row { samples })
    }
}

impl Row {
    fn sum(&self, of_cell: &[f64]) -> f64 {
        self.samples.iter().map(|(_, cell, weight)| weight * of_cell[*cell]).sum()
    }

    fn sum_in(&self, region: &Region) -> f64 {
        let is_in = |cell: &usize| region.cells.binary_search(cell).is_ok();
        self.samples.iter().filter(|(_, cell, _)| is_in(cell)).map(|(_, _, weight)| weight).sum()
    }

    /// The median position under this probability of each cell. Of two lines the samples of both are in one order, so
    /// the median is a position of one of them.
    fn median(&self, occupied: &[f64]) -> Pixel {
        let weights =
            || self.samples.iter().map(|(_, cell, weight)| weight * (occupied[*cell] + WEIGHT_OUTSIDE));
        let half = 0.5 * weights().sum::<f64>();
        let mut sum = 0.0;
        let index = weights().position(|weight| {
            sum += weight;
            sum >= half
        });
        self.samples[index.unwrap_or(self.samples.len() - 1)].0
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::Pencils;

    use super::*;
    use crate::lift::dual_convergent;
    use crate::metrics::{bits_over_prior, errors_px};

    const SIZE: (u32, u32) = (640, 480);

    fn is_in_person(p: &Pixel) -> bool {
        ((p.u - 430.0) / 50.0).powi(2) + ((p.v - 260.0) / 125.0).powi(2) <= 1.0
    }

    /// An image of which the map shows half of the keypoints, with a person in front of them.
    fn scene(rng: &mut ChaCha8Rng) -> (Vec<Observation>, Vec<Pixel>, MapVisibility) {
        let mut draw = |count: usize| -> Vec<Pixel> {
            (0..count)
                .map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)))
                .collect()
        };
        let expected = draw(900);
        let confirmed: Vec<Pixel> =
            expected.iter().step_by(2).filter(|p| !is_in_person(p)).copied().collect();
        let rest: Vec<Pixel> = draw(500).into_iter().filter(|p| !is_in_person(p)).collect();
        let person: Vec<Pixel> = draw(3000).into_iter().filter(is_in_person).take(120).collect();
        let known = confirmed.iter().map(|p| Observation::Known(*p));
        let hidden: Vec<Pixel> = [person, rest].concat();
        let sent = dual_convergent(&hidden, &Pencils::paper(SIZE.0, SIZE.1));
        (sent.into_iter().chain(known).collect(), hidden, MapVisibility { expected, confirmed })
    }

    #[test]
    fn person_in_front_of_the_map_is_found() {
        let (observations, truth, map) = scene(&mut ChaCha8Rng::seed_from_u64(1));
        let found = occlusion(&observations, &map, SIZE.0, SIZE.1);
        let person = |pixels: &[Pixel]| errors_px(pixels[..120].iter().copied(), &truth[..120]);
        let prior = person(&prior_only(&observations, SIZE.0, SIZE.1));
        let bits = bits_over_prior(&person(&found.pixels), &prior, SIZE.0, SIZE.1);
        assert!(bits > 1.0, "{bits}");
        // Rows of the person are distinguished from the others.
        let (inside, outside) = (&found.inside[..120], &found.inside[120..truth.len()]);
        let pairs = inside.iter().flat_map(|a| outside.iter().map(move |b| a > b));
        let auc = pairs.clone().filter(|above| *above).count() as f64 / pairs.count() as f64;
        assert!(auc > 0.8, "{auc}");
        // Known positions stay as they are.
        assert_eq!(found.inside[truth.len()..].iter().copied().fold(0.0, f64::max), 0.0);
    }

    #[test]
    fn without_a_map_the_answer_is_the_prior() {
        let (observations, _, _) = scene(&mut ChaCha8Rng::seed_from_u64(2));
        let found = occlusion(&observations, &MapVisibility::default(), SIZE.0, SIZE.1);
        assert_eq!(found.pixels, prior_only(&observations, SIZE.0, SIZE.1));
        let none = occlusion(&[], &MapVisibility::default(), SIZE.0, SIZE.1);
        assert!(none.pixels.is_empty() && none.inside.is_empty());
    }
}
