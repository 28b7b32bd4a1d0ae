//! A camera that rests, or one image sealed several times: the scatter of a keypoint's angles tells its distance.
//!
//! Each seal moves a keypoint by a dither of up to half a pixel each way, and each new frame by the noise of the
//! detector: a few tenths of a pixel across the line, which at distance `r` from the anchor is an angle of `1/r` of
//! that. So the angles of one keypoint scatter, and the more the nearer it is to its anchor.
//!
//! # How
//! A code is a cell of the angle, of known width. With the keypoint at angle `φ` and distance `r`, the probability of a
//! cell `[a, b]` is `F(r (b − φ)) − F(r (a − φ))`, `F` being the distribution of dither and noise across the line. Their
//! product over all codes, the own one among them, each right or of a wrong match, is integrated over `φ`; times the
//! guess's density, which grows with `r`, it is the posterior of `r`. The answer is its median.
//!
//! Exact for half-lines of one anchor. Where the lines of a keypoint have another direction (random lines, a permuted
//! position, a keypoint at the border of two anchors) they cross in it, and it is answered by
//! `several_frames`' posterior for cameras at one place.

use crate::{AttackError, Descriptors, KnownSegment, Observation, PencilRow};
use rayon::prelude::*;
use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{CameraFromWorld, Pinhole};

use crate::multi_view::depth::DepthPrior;
use crate::multi_view::frame::{Frame, FramesOptions, NEAR_PX, Sighted};
use crate::multi_view::place::Own;
use crate::multi_view::sight::Sight;

/// What is known of the codes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RestingOptions {
    /// Width of an angle's cell, radians; 0 when angles are not rounded.
    pub cell: f64,
    /// Half the side of the square that the dither fills, pixels.
    pub dither_px: f64,
    /// Standard deviation of the detector along each axis, from frame to frame, pixels; 0 for seals of one image.
    pub noise_px: f64,
    /// Probability that a row is of another keypoint.
    pub wrong: f64,
}

impl RestingOptions {
    /// Seals of one image with angles of this cell, radians: a device's dither, and rows that are of one keypoint for
    /// certain or nearly so.
    pub const fn of_one_image(cell: f64) -> Self {
        Self { cell, dither_px: 0.5, noise_px: 0.0, wrong: 0.01 }
    }

    /// Codes that nothing dithers.
    #[must_use]
    pub const fn without_dither(self) -> Self {
        Self { dither_px: 0.0, ..self }
    }

    /// Frames of a camera at rest, whose detector errs by so many pixels along each axis from frame to frame.
    #[must_use]
    pub const fn with_noise(self, noise_px: f64) -> Self {
        Self { noise_px, ..self }
    }
}

/// Distances along the line at which the posterior is kept.
const DISTANCES: usize = 64;
/// Angles over which it is integrated.
const ANGLES: usize = 96;

/// Recovers keypoints from several lines of each, of one camera at rest: `[N]`. `own`: `[N]`, the attacked frame; `others`:
/// each `[N]`, what it sent of the keypoint of row `i`, where it shows it.
///
/// # Errors
/// [`AttackError::TooFewFrames`] for no others, [`AttackError::Rows`] when they have not as many rows.
pub fn resting_camera(
    own: &[Observation],
    others: &[Vec<Option<Observation>>],
    (width, height): (u32, u32),
    options: &RestingOptions,
) -> Result<Vec<Sighted>, AttackError> {
    if others.is_empty() {
        return Err(AttackError::TooFewFrames { frames: 1 });
    }
    if let Some(other) = others.iter().find(|o| o.len() != own.len()) {
        return Err(AttackError::Rows { rows: other.len(), expected: own.len() });
    }
    let answer = |i: usize| {
        let rows: Vec<Observation> =
            std::iter::once(own[i]).chain(others.iter().filter_map(|o| o[i])).collect();
        if rows.len() < 2 {
            return Sighted::UNSEEN;
        }
        match pencil(&rows) {
            Some((row, angles)) => scattered(&row, &angles, width, height, options),
            None => crossing(&rows, width, height, options),
        }
    };
    Ok((0..own.len()).into_par_iter().map(answer).collect())
}

/// The first row and the angles of all about it, where they are lines of one anchor; `None` when they are not. Lines of an
/// anchor that is infinitely far are parallel: they do not scatter by the place of the keypoint, and cross nowhere.
fn pencil(rows: &[Observation]) -> Option<(PencilRow, Vec<f64>)> {
    let Observation::Pencil(first) = rows[0] else { return None };
    let own = first.line.direction;
    let angle = |row: &Observation| match row {
        Observation::Pencil(row) if row.anchor == first.anchor => {
            let direction = row.line.direction;
            Some((own.x * direction.y - own.y * direction.x).atan2(own.dot(&direction)))
        }
        _ => None,
    };
    Some((first, rows.iter().map(angle).collect::<Option<_>>()?))
}

/// Distribution across the line of what moves a keypoint.
struct Across {
    /// Half the widths of the two uniform parts, pixels: the dither's square seen along the line.
    halves: [f64; 2],
    /// Standard deviation of the Gaussian part, pixels.
    sigma: f64,
    /// Values from `−reach` to `reach`.
    table: Vec<f64>,
    reach: f64,
}

impl Across {
    fn new(direction: Vector2<f64>, options: &RestingOptions) -> Self {
        let mut halves = [direction.x.abs(), direction.y.abs()].map(|c| c * options.dither_px);
        halves.sort_unstable_by(f64::total_cmp);
        let mut across = Self { halves, sigma: options.noise_px, table: Vec::new(), reach: 0.0 };
        across.reach = halves[0] + halves[1] + 4.5 * across.sigma + 1e-6;
        across.table =
            (0..=TABLE).map(|k| across.exact(across.reach * (2.0 * k as f64 / TABLE as f64 - 1.0))).collect();
        across
    }

    /// The distribution function, the Gaussian part by a sum over its quantiles.
    fn exact(&self, x: f64) -> f64 {
        if self.sigma <= 0.0 {
            return self.of_dither(x);
        }
        let (mut sum, mut weight) = (0.0, 0.0);
        for k in -20..=20 {
            let z = f64::from(k) * 0.225;
            let w = (-0.5 * z * z).exp();
            sum += w * self.of_dither(x - z * self.sigma);
            weight += w;
        }
        sum / weight
    }

    /// Distribution of the sum of two uniform numbers.
    fn of_dither(&self, x: f64) -> f64 {
        let [a, b] = self.halves;
        if b <= 0.0 {
            return if x < 0.0 { 0.0 } else { 1.0 };
        }
        if a < 1e-9 {
            return ((x + b) / (2.0 * b)).clamp(0.0, 1.0);
        }
        // The integral of the trapezoid: three parts, symmetric about zero.
        let at = x.abs();
        let right = if at >= a + b {
            1.0
        } else if at <= b - a {
            0.5 + at / (2.0 * b)
        } else {
            1.0 - (a + b - at).powi(2) / (8.0 * a * b)
        };
        if x < 0.0 { 1.0 - right } else { right }
    }

    fn at(&self, x: f64) -> f64 {
        let k = (x / self.reach + 1.0) * (0.5 * TABLE as f64);
        if k <= 0.0 {
            return 0.0;
        }
        if k >= TABLE as f64 {
            return 1.0;
        }
        let low = k as usize;
        self.table[low] + (self.table[low + 1] - self.table[low]) * (k - low as f64)
    }
}

const TABLE: usize = 512;

/// The posterior of the distance by the scatter of the angles.
fn scattered(row: &PencilRow, angles: &[f64], width: u32, height: u32, options: &RestingOptions) -> Sighted {
    let segment = KnownSegment::hull(&Observation::Pencil(*row), width, height);
    let Some(segment) = segment.filter(|s| !s.is_empty() && row.begins().is_some()) else {
        return Sighted::UNSEEN;
    };
    // Angles that are not rounded are cells so narrow that nothing changes across them.
    let half = (0.5 * options.cell).max(1e-7);
    let across = Across::new(segment.direction, options);
    // Equal codes once.
    let mut sorted = angles.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut codes: Vec<(f64, i32)> = Vec::new();
    for angle in sorted {
        match codes.last_mut() {
            Some((last, count)) if (angle - *last).abs() < 0.25 * half => *count += 1,
            _ => codes.push((angle, 1)),
        }
    }
    let middle = codes[codes.len() / 2].0;
    let wrong = options.wrong * 2.0 * half / std::f64::consts::PI;
    let part = (segment.far - segment.near) / DISTANCES as f64;
    let posterior: Vec<(f64, f64)> = (0..DISTANCES)
        .map(|k| {
            let r = (segment.near + part * (k as f64 + 0.5)).max(0.5);
            let widest = across.reach / r + half;
            let step = 2.0 * widest / ANGLES as f64;
            let one = |a: usize| {
                let angle = middle + step * (a as f64 + 0.5 - 0.5 * ANGLES as f64);
                let of = |(code, count): &(f64, i32)| {
                    let off = code - angle;
                    let right = across.at(r * (off + half)) - across.at(r * (off - half));
                    ((1.0 - options.wrong) * right + wrong).powi(*count)
                };
                codes.iter().map(of).product::<f64>()
            };
            let likelihood = step * (0..ANGLES).map(one).sum::<f64>();
            // Of evenly spread keypoints a wedge holds the more, the farther out.
            (r, if row.holds(segment.at(r), 0.0) { r * likelihood } else { 0.0 })
        })
        .collect();
    let total: f64 = posterior.iter().map(|p| p.1).sum();
    if !(total > 0.0 && total.is_finite()) {
        return Sighted::UNSEEN;
    }
    let mut sum = 0.0;
    let mut answer = posterior[DISTANCES - 1].0;
    for (r, weight) in &posterior {
        if sum + weight >= 0.5 * total {
            answer = r + part * ((0.5 * total - sum) / weight - 0.5);
            break;
        }
        sum += weight;
    }
    let variance: f64 = posterior.iter().map(|(r, w)| w * (r - answer).powi(2)).sum::<f64>() / total;
    let within =
        posterior.iter().filter(|p| (p.0 - answer).abs() <= NEAR_PX).map(|p| p.1).sum::<f64>() / total;
    let others = angles.len() - 1;
    // Rows are told to be of one keypoint: agreement is no evidence of it, and no chance is counted.
    Sighted {
        pixel: Some(segment.at(answer)),
        matched: others,
        agreeing: others,
        sigma_px: variance.sqrt(),
        within,
        by_chance: 0.0,
    }
}

/// Lines of other directions: cameras at one place, whatever the depth.
fn crossing(rows: &[Observation], width: u32, height: u32, options: &RestingOptions) -> Sighted {
    if let Observation::Known(pixel) = rows[0] {
        return Sighted::given(pixel);
    }
    let side = f64::from(width.max(height));
    let camera = Pinhole {
        width,
        height,
        focal: [side; 2],
        principal: [0.5 * f64::from(width), 0.5 * f64::from(height)],
    };
    let Ok(descriptors) = Descriptors::new(&[], 1) else { return Sighted::UNSEEN };
    let frame = Frame {
        camera,
        cam_from_world: CameraFromWorld::identity(),
        observations: rows,
        descriptors: &descriptors,
    };
    let sight = Sight::new(&frame, &frame);
    let others: Vec<(&Sight, &Observation)> =
        rows[1..].iter().filter(|o| !matches!(o, Observation::Known(_))).map(|o| (&sight, o)).collect();
    let depths = DepthPrior::new([1.0, 2.0], &[], width, height);
    // Two dithers, two detectors, and the rounding of what is sent.
    let noise_px = (2.0 * (options.dither_px.powi(2) / 3.0 + options.noise_px.powi(2)) + 0.02).sqrt();
    let frames = FramesOptions { noise_px, wrong: options.wrong, ..FramesOptions::with_depths([1.0, 2.0]) };
    Own::new(&frame, 0).sighted(&others, &depths, &frames)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_distribution_across_is_that_of_drawn_dithers() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (angle, noise_px) in [(0.0, 0.0), (0.3, 0.0), (0.785_f64, 0.0), (1.2, 0.4)] {
            let options = RestingOptions::of_one_image(1e-3).with_noise(noise_px);
            let direction = Vector2::new(angle.cos(), angle.sin());
            let across = Across::new(direction, &options);
            let mut drawn: Vec<f64> = (0..20_000)
                .map(|_| {
                    let mut step = || {
                        // Twelve uniform numbers make a Gaussian well enough.
                        let gauss: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                        rng.random::<f64>() - 0.5 + noise_px * gauss
                    };
                    step() * -direction.y + step() * direction.x
                })
                .collect();
            drawn.sort_unstable_by(f64::total_cmp);
            for share in [0.02, 0.1, 0.3, 0.5, 0.8, 0.95] {
                let x = drawn[(share * 20_000.0) as usize];
                assert!((across.at(x) - share).abs() < 0.015, "{angle} {share}: {}", across.at(x));
            }
        }
    }
}
