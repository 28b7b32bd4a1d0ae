//! The distribution of wrong matches: that of the query's observations.
//!
//! A wrong match pairs a map point with an unrelated keypoint, so its observation is distributed as the query's
//! keypoints are. Where they are dense (foliage, fur, a printed page), many wrong matches fall near any projection, and
//! agreement there is weaker evidence than in a sparse part of the image. The distribution is estimated from the
//! query's own matches, as a histogram that is smoothed and mixed with the even spread.

use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Arc, Pinhole};

use crate::likelihood::problem::Correspondences;

/// Share of wrong matches that are assumed to be evenly spread: no part of the image counts as impossible.
const EVEN_SHARE: f64 = 0.15;

/// Pseudo-count of evenly spread matches: few matches determine their distribution poorly.
const EVEN_MATCHES: f64 = 8.0;

/// Bins of a half circle; smoothed over five of them, which is 7°.
const ANGLE_BINS: usize = 128;

/// Bins along the longer side of the image; smoothed over five of them.
const PIXEL_BINS: usize = 48;

/// Bins of the direction of lines, not smoothed: 12° wide.
const DIRECTION_BINS: usize = 15;

/// Bins of a line's distance from the middle, over the image's diagonal; smoothed over five of them.
const OFFSET_BINS: usize = 48;

/// Weights of a bin and its neighbours at distances 1 and 2: they sum to 1.
const SMOOTHING: [f64; 3] = [0.30, 0.23, 0.12];

/// Logarithm of the likelihood of each correspondence's observation for a wrong match, relative to evenly spread wrong
/// matches, `[N]`.
pub(crate) fn log_density(observations: &Correspondences, camera: &Pinhole) -> Vec<f64> {
    let size = [f64::from(camera.width), f64::from(camera.height)];
    let density = match observations {
        Correspondences::Points { pixels } => {
            of_pixels(&pixels.iter().map(|p| [p.u, p.v]).collect::<Vec<_>>(), size)
        }
        Correspondences::Lines { lines } => {
            of_lines(&lines.iter().map(|l| *l.coefficients()).collect::<Vec<_>>(), size)
        }
        Correspondences::Anchored { pencils, lines } => {
            let mut density = vec![1.0; lines.len()];
            for anchor in pencils.anchors() {
                let of_anchor = || lines.iter().enumerate().filter(|(_, line)| line.0 == anchor);
                let angles: Vec<f64> = of_anchor().map(|(_, line)| line.1).collect();
                for ((i, _), at) in of_anchor().zip(of_angles(&angles, &pencils.arc(anchor))) {
                    density[i] = at;
                }
            }
            density
        }
    };
    density.into_iter().map(f64::ln).collect()
}

/// Density over the arc of the image at each of these angles, relative to the even one, `[N]`.
fn of_angles(angles: &[f64], arc: &Arc) -> Vec<f64> {
    let bins = ((arc.length / std::f64::consts::PI * ANGLE_BINS as f64).ceil() as usize).max(1);
    let bin = |angle: f64| ((arc.share(angle) * bins as f64) as usize).min(bins - 1);
    let mut counts = vec![0.0; bins];
    for &angle in angles {
        counts[bin(angle)] += 1.0;
    }
    let density = relative(&smoothed(&counts), angles.len());
    angles.iter().map(|&angle| density[bin(angle)]).collect()
}

/// Density over an image of this size at each of these pixels, relative to the even one, `[N]`.
fn of_pixels(pixels: &[[f64; 2]], size: [f64; 2]) -> Vec<f64> {
    let bins = size.map(|s| ((PIXEL_BINS as f64 * s / size[0].max(size[1])).ceil() as usize).max(1));
    let at = |k: usize, x: f64| ((x / size[k] * bins[k] as f64) as usize).min(bins[k] - 1);
    let bin = |p: &[f64; 2]| at(1, p[1]) * bins[0] + at(0, p[0]);
    let mut counts = vec![0.0; bins[0] * bins[1]];
    for pixel in pixels {
        counts[bin(pixel)] += 1.0;
    }
    for row in counts.chunks_mut(bins[0]) {
        row.copy_from_slice(&smoothed(row));
    }
    for column in 0..bins[0] {
        let old: Vec<f64> = counts.iter().skip(column).step_by(bins[0]).copied().collect();
        for (row, new) in smoothed(&old).into_iter().enumerate() {
            counts[row * bins[0] + column] = new;
        }
    }
    let density = relative(&counts, pixels.len());
    pixels.iter().map(|pixel| density[bin(pixel)]).collect()
}

/// Density at each of these lines among those of a similar direction, relative to that of lines through evenly spread
/// pixels of an image of this size, `[N]`. A line is the unit normal and offset `(a, b, c)` of `a u + b v + c = 0`.
fn of_lines(lines: &[Vector3<f64>], size: [f64; 2]) -> Vec<f64> {
    let diagonal = size[0].hypot(size[1]);
    // Direction of the normal in [0, π) and signed distance of the image's middle.
    let polar = |line: &Vector3<f64>| {
        let angle = line.y.atan2(line.x);
        let distance = line.x * 0.5 * size[0] + line.y * 0.5 * size[1] + line.z;
        if angle < 0.0 { (angle + std::f64::consts::PI, -distance) } else { (angle, distance) }
    };
    let direction = |angle: f64| {
        ((angle / std::f64::consts::PI * DIRECTION_BINS as f64) as usize).min(DIRECTION_BINS - 1)
    };
    let offset =
        |distance: f64| (((distance / diagonal + 0.5) * OFFSET_BINS as f64) as usize).min(OFFSET_BINS - 1);
    let mut counts = vec![vec![0.0; OFFSET_BINS]; DIRECTION_BINS];
    for line in lines {
        let (angle, distance) = polar(line);
        counts[direction(angle)][offset(distance)] += 1.0;
    }
    let density: Vec<Vec<f64>> = (0..DIRECTION_BINS)
        .map(|k| {
            let all: f64 = counts[k].iter().sum();
            let angle = (k as f64 + 0.5) / DIRECTION_BINS as f64 * std::f64::consts::PI;
            let even = smoothed(&even_offsets(angle, size, diagonal));
            let counts = smoothed(&counts[k]);
            (0..OFFSET_BINS).map(|o| mixed(counts[o], even[o] * all, all)).collect()
        })
        .collect();
    lines
        .iter()
        .map(|line| {
            let (angle, distance) = polar(line);
            density[direction(angle)][offset(distance)]
        })
        .collect()
}

/// Share of an image's pixels in each bin of distance across a direction.
fn even_offsets(angle: f64, size: [f64; 2], diagonal: f64) -> Vec<f64> {
    // The sum of two even spreads of these half widths: a trapezoid.
    let half = [0.5 * size[0] * angle.cos().abs(), 0.5 * size[1] * angle.sin().abs()];
    let (inner, outer) = ((half[0] - half[1]).abs(), half[0] + half[1]);
    let height = |distance: f64| {
        if distance <= inner { 1.0 } else { ((outer - distance) / (outer - inner)).max(0.0) }
    };
    let at = |bin: usize| height((((bin as f64 + 0.5) / OFFSET_BINS as f64 - 0.5) * diagonal).abs());
    let total: f64 = (0..OFFSET_BINS).map(at).sum();
    (0..OFFSET_BINS).map(|bin| at(bin) / total).collect()
}

/// Counts smoothed over their neighbours; at the ends they are mirrored, so that an even spread stays even.
fn smoothed(counts: &[f64]) -> Vec<f64> {
    let n = counts.len();
    let mut smooth = vec![0.0; n];
    for (i, &count) in counts.iter().enumerate() {
        smooth[i] += count * SMOOTHING[0];
        for (distance, weight) in SMOOTHING.iter().enumerate().skip(1) {
            let below = if i >= distance { i - distance } else { (distance - i - 1).min(n - 1) };
            let above =
                if i + distance < n { i + distance } else { (2 * n - 1).saturating_sub(i + distance) };
            smooth[below] += count * weight;
            smooth[above.min(n - 1)] += count * weight;
        }
    }
    smooth
}

/// Smoothed counts as a density relative to the even one.
fn relative(counts: &[f64], all: usize) -> Vec<f64> {
    let even = all as f64 / counts.len() as f64;
    counts.iter().map(|&count| mixed(count, even, all as f64)).collect()
}

/// A count relative to the expected count of an even spread, mixed with the even spread according to the number of
/// matches.
fn mixed(count: f64, expected: f64, all: f64) -> f64 {
    let even = (EVEN_SHARE * all + EVEN_MATCHES) / (all + EVEN_MATCHES);
    if expected > 0.0 { even + (1.0 - even) * count / expected } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF: Arc = Arc { from: 0.0, length: std::f64::consts::PI };

    #[test]
    fn even_spread_has_unit_density() {
        let angles: Vec<f64> =
            (0..4096).map(|i| (f64::from(i) + 0.5) / 4096.0 * std::f64::consts::PI).collect();
        assert!(of_angles(&angles, &HALF).iter().all(|d| (d - 1.0).abs() < 1e-6));
        let pixels: Vec<[f64; 2]> =
            (0..480 * 640).step_by(7).map(|i| [f64::from(i % 640) + 0.5, f64::from(i / 640) + 0.5]).collect();
        assert!(of_pixels(&pixels, [640.0, 480.0]).iter().all(|d| (d - 1.0).abs() < 0.2));
    }

    #[test]
    fn clusters_have_high_density() {
        let mut angles = vec![1.0; 99];
        angles.push(2.5);
        let density = of_angles(&angles, &HALF);
        assert!(density[0] > 15.0, "{}", density[0]);
        assert!(density[99] > EVEN_SHARE && density[99] < 1.3, "{}", density[99]);
        let mut pixels = vec![[100.0, 100.0]; 99];
        pixels.push([600.0, 479.9]);
        let density = of_pixels(&pixels, [640.0, 480.0]);
        assert!(density[0] > 50.0 && density[99] < 3.0, "{} {}", density[0], density[99]);
    }

    #[test]
    fn borders_and_non_finite_values_stay_in_range() {
        assert!(of_angles(&[], &HALF).is_empty());
        for angle in [-1.0, 0.0, std::f64::consts::PI, 1e9, f64::NAN] {
            assert!(of_angles(&[angle], &HALF)[0].is_finite());
        }
        for pixel in [[-5.0, -5.0], [1e9, 1e9], [f64::NAN, 3.0], [640.0, 480.0]] {
            assert!(of_pixels(&[pixel], [640.0, 480.0])[0].is_finite());
        }
        let total: f64 = smoothed(&[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]).iter().sum();
        assert!((total - 3.0).abs() < 1e-9);
    }
}
