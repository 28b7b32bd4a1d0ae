//! Attack on a stationary camera, or on several seals of one image: the scatter of a keypoint's angles reveals its
//! distance from the anchor.
//!
//! Each seal moves a keypoint by a dither of up to half a pixel in each direction, and each new frame by the noise of
//! the detector: a few tenths of a pixel across the line, which at distance `r` from the anchor is `1/r` of that as
//! an angle. So the angles of one keypoint scatter, and the scatter grows as the distance to the anchor shrinks.
//!
//! # Method
//! A code is a cell of the angle with known width. For a keypoint at angle `φ` and distance `r`, the probability of a
//! cell `[a, b]` is `F(r (b − φ)) − F(r (a − φ))`, where `F` is the distribution of dither and noise across the line.
//! The product over all codes, the attacked frame's included, each a mixture of right and wrong matches, is
//! integrated over `φ`. Times the prior density, which grows with `r`, it is the posterior of `r`. The answer is its
//! median.
//!
//! The model is exact for half-lines of one anchor. If the lines of a keypoint have different directions (random
//! lines, a permuted position, a keypoint at the border of two anchors), they intersect in it, and the answer is the
//! posterior of `multi_view_attack` for cameras with one centre.

use crate::{AttackError, DecodedDescriptors, KnownSegment, Observation, PencilRow};
use rayon::prelude::*;
use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{CameraFromWorld, Pinhole};

use crate::multi_view::depth::DepthPrior;
use crate::multi_view::frame::{Frame, FramesOptions, NEAR_PX, TriangulatedKeypoint};
use crate::multi_view::line_posterior::AttackedKeypoint;
use crate::multi_view::ray_plane::RelativeFrame;

/// Model of the angle codes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StaticCameraOptions {
    /// Width of an angle cell, radians; 0 for angles without rounding.
    pub cell: f64,
    /// Half the side of the dither's square, pixels.
    pub dither_px: f64,
    /// Standard deviation of the detector along each axis, from frame to frame, pixels; 0 for seals of one image.
    pub noise_px: f64,
    /// Probability that a row belongs to another keypoint.
    pub wrong: f64,
}

impl StaticCameraOptions {
    /// Seals of one image with this angle cell, radians: a device's dither, and almost certain row associations.
    pub const fn of_one_image(cell: f64) -> Self {
        Self { cell, dither_px: 0.5, noise_px: 0.0, wrong: 0.01 }
    }

    /// The same without dither.
    #[must_use]
    pub const fn without_dither(self) -> Self {
        Self { dither_px: 0.0, ..self }
    }

    /// Frames of a stationary camera whose detector has this noise along each axis from frame to frame, pixels.
    #[must_use]
    pub const fn with_noise(self, noise_px: f64) -> Self {
        Self { noise_px, ..self }
    }
}

/// Number of distances at which the posterior is evaluated.
const DISTANCES: usize = 64;
/// Number of angles over which it is integrated.
const ANGLES: usize = 96;

/// Recovers keypoints from several lines of each, taken by one stationary camera: `[N]`. `own`: `[N]`, the attacked
/// frame; `others`: each `[N]`, the observation of the keypoint of row `i` in that frame, if there is one.
///
/// # Errors
/// [`AttackError::TooFewFrames`] without other frames, [`AttackError::Rows`] when the numbers of rows differ.
pub fn static_camera(
    own: &[Observation],
    others: &[Vec<Option<Observation>>],
    (width, height): (u32, u32),
    options: &StaticCameraOptions,
) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
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
            return TriangulatedKeypoint::NO_MATCH;
        }
        match pencil(&rows) {
            Some((row, angles)) => by_scatter(&row, &angles, width, height, options),
            None => by_intersection(&rows, width, height, options),
        }
    };
    Ok((0..own.len()).into_par_iter().map(answer).collect())
}

/// The first row and the angles of all rows around it, if they are lines of one anchor; otherwise `None`. Lines of an
/// anchor at infinity are parallel: their scatter does not depend on the keypoint's position, and they do not
/// intersect.
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

/// Distribution of the keypoint's displacement across the line.
struct DisplacementDistribution {
    /// Half widths of the two uniform parts, pixels: the dither's square projected across the line.
    halves: [f64; 2],
    /// Standard deviation of the Gaussian part, pixels.
    sigma: f64,
    /// Values from `−reach` to `reach`.
    table: Vec<f64>,
    reach: f64,
}

impl DisplacementDistribution {
    fn new(direction: Vector2<f64>, options: &StaticCameraOptions) -> Self {
        let mut halves = [direction.x.abs(), direction.y.abs()].map(|c| c * options.dither_px);
        halves.sort_unstable_by(f64::total_cmp);
        let mut across = Self { halves, sigma: options.noise_px, table: Vec::new(), reach: 0.0 };
        across.reach = halves[0] + halves[1] + 4.5 * across.sigma + 1e-6;
        across.table =
            (0..=TABLE).map(|k| across.exact(across.reach * (2.0 * k as f64 / TABLE as f64 - 1.0))).collect();
        across
    }

    /// The distribution function; the Gaussian part is a sum over its quantiles.
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

    /// Distribution function of the sum of two uniform variables.
    fn of_dither(&self, x: f64) -> f64 {
        let [a, b] = self.halves;
        if b <= 0.0 {
            return if x < 0.0 { 0.0 } else { 1.0 };
        }
        if a < 1e-9 {
            return ((x + b) / (2.0 * b)).clamp(0.0, 1.0);
        }
        // Integral of a trapezoid: three pieces, symmetric about zero.
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

/// The posterior of the distance, from the scatter of the angles.
fn by_scatter(
    row: &PencilRow,
    angles: &[f64],
    width: u32,
    height: u32,
    options: &StaticCameraOptions,
) -> TriangulatedKeypoint {
    let segment = KnownSegment::hull(&Observation::Pencil(*row), width, height);
    let Some(segment) = segment.filter(|s| !s.is_empty() && row.origin().is_some()) else {
        return TriangulatedKeypoint::NO_MATCH;
    };
    // Angles without rounding are very narrow cells, in which the density is constant.
    let half = (0.5 * options.cell).max(1e-7);
    let across = DisplacementDistribution::new(segment.direction, options);
    // Count equal codes once.
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
            // With uniform keypoints the density in a wedge grows with the distance.
            (r, if row.holds(segment.at(r), 0.0) { r * likelihood } else { 0.0 })
        })
        .collect();
    let total: f64 = posterior.iter().map(|p| p.1).sum();
    if !(total > 0.0 && total.is_finite()) {
        return TriangulatedKeypoint::NO_MATCH;
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
    // The row associations are given: agreement is no evidence for them, so chance agreements are not counted.
    TriangulatedKeypoint {
        pixel: Some(segment.at(answer)),
        matched: others,
        agreeing: others,
        sigma_px: variance.sqrt(),
        within,
        by_chance: 0.0,
    }
}

/// Lines with different directions: cameras with one centre, independent of depth.
fn by_intersection(
    rows: &[Observation],
    width: u32,
    height: u32,
    options: &StaticCameraOptions,
) -> TriangulatedKeypoint {
    if let Observation::Known(pixel) = rows[0] {
        return TriangulatedKeypoint::known(pixel);
    }
    let side = f64::from(width.max(height));
    let camera = Pinhole {
        width,
        height,
        focal: [side; 2],
        principal: [0.5 * f64::from(width), 0.5 * f64::from(height)],
    };
    let Ok(descriptors) = DecodedDescriptors::new(&[], 1) else { return TriangulatedKeypoint::NO_MATCH };
    let frame = Frame {
        camera,
        cam_from_world: CameraFromWorld::identity(),
        observations: rows,
        descriptors: &descriptors,
    };
    let relative = RelativeFrame::new(&frame, &frame);
    let others: Vec<(&RelativeFrame, &Observation)> =
        rows[1..].iter().filter(|o| !matches!(o, Observation::Known(_))).map(|o| (&relative, o)).collect();
    let depths = DepthPrior::new([1.0, 2.0], &[], width, height);
    // Two dithers, two detectors, and the rounding of the sent values.
    let noise_px = (2.0 * (options.dither_px.powi(2) / 3.0 + options.noise_px.powi(2)) + 0.02).sqrt();
    let frames = FramesOptions { noise_px, wrong: options.wrong, ..FramesOptions::with_depths([1.0, 2.0]) };
    AttackedKeypoint::new(&frame, 0).triangulate(&others, &depths, &frames)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn displacement_distribution_matches_samples() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (angle, noise_px) in [(0.0, 0.0), (0.3, 0.0), (0.785_f64, 0.0), (1.2, 0.4)] {
            let options = StaticCameraOptions::of_one_image(1e-3).with_noise(noise_px);
            let direction = Vector2::new(angle.cos(), angle.sin());
            let across = DisplacementDistribution::new(direction, &options);
            let mut drawn: Vec<f64> = (0..20_000)
                .map(|_| {
                    let mut step = || {
                        // The sum of twelve uniform variables approximates a Gaussian.
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
