//! The similarity that fits known positions, with what it leaves open.
//!
//! With `x_i` positions in the map and `y_i` where they are known to be,
//!
//! ```text
//! y_i = s R x_i + t + e_i
//! ```
//!
//! The errors `e_i` have one standard deviation along the ground and another in height, both estimated; some positions are
//! wrong, and some have no height. A direction of gravity that is known in the map, about as the images know it, is a
//! measurement of `R` beside the positions: GPS of a small place tilts the map by more than its images do.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{DMatrix, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};

use veiloc_geometry::rotation_to_z;

use super::level::MapUp;
use crate::coordinate_frames::{Similarity3, median};

/// A pair of positions, in axes whose `z` is up if that is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    /// In the map.
    pub(super) x: Vector3<f64>,
    /// In the new coordinate frame.
    pub(super) y: Vector3<f64>,
    /// Whether `y.z` is known.
    pub(super) has_height: bool,
    /// Least standard deviation of `y` along each axis.
    pub(super) least_sd: f64,
}

/// What is known of the errors of positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Errors {
    /// `z` is up, so errors of heights are other ones than those along the ground.
    pub(super) has_vertical: bool,
    /// Least correlation of the errors of two positions that follow each other.
    pub(super) least_correlation: f64,
}

/// A fitted similarity.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) similarity: Similarity3,
    /// Whether each pair was used, `[N]`.
    pub(super) used: Vec<bool>,
    /// Root mean square of the residuals of those that were used.
    pub(super) rms: f64,
    /// Covariance of the logarithm of the scale, the rotation (radians, about the axes of the new coordinate frame), and the
    /// new position of [`Self::center`].
    pub(super) covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// Mean of the used positions in the map.
    pub(super) center: Vector3<f64>,
}

/// Logarithm of the scale, rotation, position.
const PARAMETERS: usize = 7;
/// Positions whose residual is above this many standard deviations are wrong.
const OUTLIER_SDS: f64 = 2.5;
/// Second over first singular value of positions, below which they lie on a line.
const MIN_SHAPE: f64 = 0.02;
/// Samples, about.
const MAX_SAMPLES: usize = 2000;
/// Rounds of selection and estimation.
const ROUNDS: usize = 30;
/// Largest correlation that is assumed: at one, no number of positions would say anything.
const MAX_CORRELATION: f64 = 0.95;
/// Standard deviation of heights of which none is known, in multiples of the extent: any height.
const UNKNOWN_HEIGHT: f64 = 1e6;

/// Fits a similarity; `None` when the pairs determine none: fewer than three, or two with a known up direction, or all at one
/// place, or on a line (with a known up direction: above each other). `up` is the direction in the map that becomes `z`.
///
pub(super) fn fit(pairs: &[Pair], up: Option<MapUp>, errors: Errors) -> Option<Fit> {
    let start = start(pairs, up)?;
    let mut similarity = start;
    let mut used = vec![true; pairs.len()];
    for round in 0..ROUNDS {
        let residuals = residuals(pairs, &similarity);
        // 1.4826 makes the median of absolute errors a standard deviation; 5 / n corrects for few positions.
        let sd = 1.4826 * median(residuals.clone()) * (1.0 + 5.0 / pairs.len() as f64);
        let limit = (OUTLIER_SDS * sd).max(1e-9 * extent(pairs));
        let next: Vec<bool> = residuals.iter().map(|r| *r <= limit).collect();
        if round > 0 && next == used {
            break;
        }
        let Some(refined) = refine(pairs, &next, &similarity, up, errors) else { break };
        (similarity, used) = (refined.0, next);
    }
    let (similarity, covariance, center) = refine(pairs, &used, &similarity, up, errors)?;
    let residuals = residuals(pairs, &similarity);
    let squares: f64 = residuals.iter().zip(&used).filter(|(_, used)| **used).map(|(r, _)| r * r).sum();
    let rms = (squares / used.iter().filter(|used| **used).count().max(1) as f64).sqrt();
    Some(Fit { similarity, used, rms, covariance, center })
}

fn extent(pairs: &[Pair]) -> f64 {
    pairs.iter().map(|pair| pair.y.norm()).fold(0.0, f64::max)
}

/// What is left of a pair; without a height, along the ground.
pub(super) fn residual(pair: &Pair, similarity: &Similarity3) -> Vector3<f64> {
    let mut left = pair.y - similarity.transform(&pair.x);
    if !pair.has_height {
        left.z = 0.0;
    }
    left
}

fn residuals(pairs: &[Pair], similarity: &Similarity3) -> Vec<f64> {
    pairs.iter().map(|pair| residual(pair, similarity).norm()).collect()
}

/// Of many small samples, and of all pairs, the similarity with the least median residual in units of the map: in those of the
/// new frame, a similarity that shrinks the map to where most positions are alike would win.
fn start(pairs: &[Pair], up: Option<MapUp>) -> Option<Similarity3> {
    let mut best: Option<(f64, Similarity3)> = None;
    let mut consider = |found: Option<Similarity3>| {
        let Some(found) = found else { return };
        let score = median(residuals(pairs, &found)) / found.scale;
        if score.is_finite() && best.is_none_or(|(least, _)| score < least) {
            best = Some((score, found));
        }
    };
    if let Some(up) = up {
        let all: Vec<usize> = (0..pairs.len()).collect();
        consider(level_fit(pairs, &all, &up));
        for sample in samples::<2>(pairs.len()) {
            consider(level_fit(pairs, &sample, &up));
        }
    } else {
        let with_height: Vec<_> =
            pairs.iter().filter(|pair| pair.has_height).map(|pair| (pair.x, pair.y)).collect();
        if shape(with_height.iter().map(|pair| pair.1)) < MIN_SHAPE {
            return None;
        }
        consider(closed_form(&with_height));
        for sample in samples::<3>(with_height.len()) {
            consider(closed_form(&sample.map(|i| with_height[i])));
        }
    }
    best.map(|(_, found)| found)
}

/// Scale, heading and position of some pairs, with gravity as known; `None` if they lie above each other.
fn level_fit(pairs: &[Pair], chosen: &[usize], up: &MapUp) -> Option<Similarity3> {
    let level = rotation_to_z(&up.direction);
    let count = chosen.len() as f64;
    let moved: Vec<(Vector3<f64>, &Pair)> = chosen.iter().map(|&i| (level * pairs[i].x, &pairs[i])).collect();
    let mean_x = moved.iter().map(|(x, _)| x).sum::<Vector3<f64>>() / count;
    let mean_y = moved.iter().map(|(_, pair)| pair.y).sum::<Vector3<f64>>() / count;
    // With complex numbers, y = z x: z = Σ y x̄ / Σ |x|².
    let (mut z, mut spread) = (Vector2::zeros(), 0.0);
    for (x, pair) in &moved {
        let (x, y) = ((x - mean_x).xy(), (pair.y - mean_y).xy());
        z += Vector2::new(y.dot(&x), x.x * y.y - x.y * y.x);
        spread += x.norm_squared();
    }
    let all: f64 = pairs.iter().map(|pair| (pair.x - pairs[0].x).norm()).fold(0.0, f64::max);
    let scale = z.norm() / spread;
    if !(spread > (MIN_SHAPE * all).powi(2) && scale.is_finite() && scale > 0.0) {
        return None;
    }
    let heading = Rotation3::from_axis_angle(&Vector3::z_axis(), z.y.atan2(z.x));
    let rotation = heading * level;
    let lifts: Vec<f64> =
        (moved.iter().filter(|(_, pair)| pair.has_height)).map(|(x, pair)| pair.y.z - scale * x.z).collect();
    let lift = if lifts.is_empty() { 0.0 } else { median(lifts) };
    let ground = mean_y - scale * (heading * mean_x);
    Some(Similarity3 { scale, rotation, translation: Vector3::new(ground.x, ground.y, lift) })
}

type Estimate = (Similarity3, SMatrix<f64, PARAMETERS, PARAMETERS>, Vector3<f64>);

/// Least squares over the used pairs: the similarity, its covariance, and the point of the map that it refers to.
fn refine(
    pairs: &[Pair],
    used: &[bool],
    start: &Similarity3,
    up: Option<MapUp>,
    errors: Errors,
) -> Option<Estimate> {
    let chosen: Vec<&Pair> =
        pairs.iter().zip(used).filter(|(_, used)| **used).map(|(pair, _)| pair).collect();
    let center = chosen.iter().map(|pair| pair.x).sum::<Vector3<f64>>() / chosen.len().max(1) as f64;
    let size = chosen.iter().map(|pair| (pair.x - center).norm()).fold(0.0, f64::max) * start.scale;
    let (mut scale, mut rotation, mut at) = (start.scale, start.rotation, start.transform(&center));
    let mut information = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut of_positions = information;
    for _ in 0..ROUNDS {
        let here = Similarity3 { scale, rotation, translation: at - scale * (rotation * center) };
        let noise = noise(&chosen, &here, errors.has_vertical);
        information.fill(0.0);
        let mut gradient = SVector::<f64, PARAMETERS>::zeros();
        for pair in &chosen {
            let moved = scale * (rotation * (pair.x - center));
            let left = residual(pair, &here);
            let turn = -moved.cross_matrix();
            let [ground, height] = noise.map(|sd| sd.max(pair.least_sd));
            for axis in 0..if pair.has_height { 3 } else { 2 } {
                let sd = if axis == 2 { height } else { ground };
                let mut row = SVector::<f64, PARAMETERS>::zeros();
                row[0] = moved[axis];
                row.fixed_rows_mut::<3>(1).copy_from(&turn.row(axis).transpose());
                row[4 + axis] = 1.0;
                information += row * row.transpose() / (sd * sd);
                gradient += row * (left[axis] / (sd * sd));
            }
        }
        of_positions = information;
        if !chosen.iter().any(|pair| pair.has_height) {
            information[(6, 6)] += (UNKNOWN_HEIGHT * size).powi(-2);
        }
        if let Some(up) = up {
            let sd = up.sd_deg.to_radians();
            let tilt = rotation * up.direction;
            let turn = -tilt.cross_matrix();
            for axis in 0..2 {
                let row = turn.row(axis).transpose() / sd;
                let mut block = information.fixed_view_mut::<3, 3>(1, 1);
                block += row * row.transpose();
                let mut slope = gradient.fixed_rows_mut::<3>(1);
                slope += row * (-tilt[axis] / sd);
            }
        }
        let step = information.cholesky()?.solve(&gradient);
        if !step.iter().all(|s| s.is_finite()) {
            return None;
        }
        scale *= step[0].clamp(-0.5, 0.5).exp();
        rotation = Rotation3::from_scaled_axis(step.fixed_rows::<3>(1).into_owned()) * rotation;
        at += step.fixed_rows::<3>(4);
        let angle = step.fixed_rows::<3>(1).norm();
        if step[0].abs().max(angle) < 1e-12 && step.fixed_rows::<3>(4).norm() < 1e-12 * size {
            break;
        }
    }
    rotation.renormalize();
    let rows: usize = chosen.iter().map(|pair| if pair.has_height { 3 } else { 2 }).sum();
    // The noise is estimated from few residuals: its estimate is a Student distribution.
    let freedom = rows as f64 - free_parameters(up);
    let few = if freedom > 3.0 { freedom / (freedom - 2.0) } else { 3.0 };
    let found = Similarity3 { scale, rotation, translation: at - scale * (rotation * center) };
    // What positions say is repeated; the estimate itself takes each for one: residuals of a wrong direction are alike, too.
    let excess = repetition(&chosen, &found, errors.least_correlation) - 1.0;
    let inverse = information.cholesky()?.inverse();
    let covariance = inverse * (information + of_positions * excess) * inverse * few;
    Some((found, covariance, center))
}

/// Number of parameters that the positions determine alone.
fn free_parameters(up: Option<MapUp>) -> f64 {
    if up.is_some() { 5.0 } else { PARAMETERS as f64 }
}

/// How many positions say as much as one whose errors are independent. The error of a fix is mostly that of the fix before, and the
/// fit takes a part of what they have in common for the shape of the place: its covariance would be far too small. As for an
/// autoregressive process, `(1 + ρ) / (1 - ρ)` with the correlation `ρ` of residuals that follow each other.
fn repetition(chosen: &[&Pair], here: &Similarity3, least: f64) -> f64 {
    let left: Vec<Vector2<f64>> = chosen.iter().map(|pair| residual(pair, here).xy()).collect();
    let count = left.len() as f64;
    let square: f64 = left.iter().map(Vector2::norm_squared).sum();
    let product: f64 = left.iter().zip(left.iter().skip(1)).map(|(a, b)| a.dot(b)).sum();
    let found = product / square;
    // By chance it is as large as this in one of twenty lists. What a fit takes away makes residuals less alike (Kendall, Biometrika
    // 1954, for the mean alone; here for 2.5 parameters an axis).
    let is_seen = found > (2.0 / count).sqrt();
    let correlation = if is_seen { (found + 2.5 * (1.0 + 4.0 * found) / count).max(least) } else { least };
    (1.0 + correlation.min(MAX_CORRELATION)) / (1.0 - correlation.min(MAX_CORRELATION))
}

/// Standard deviation of the errors along the ground and in height.
fn noise(chosen: &[&Pair], here: &Similarity3, has_vertical: bool) -> [f64; 2] {
    let (mut ground, mut height, mut heights) = (0.0, 0.0, 0.0);
    for pair in chosen {
        let left = residual(pair, here);
        ground += left.xy().norm_squared();
        height += left.z * left.z;
        heights += f64::from(u8::from(pair.has_height));
    }
    let rows = 2.0 * chosen.len() as f64;
    let all = rows + heights;
    let few = all / (all - PARAMETERS as f64).max(1.0);
    // Exact positions: the weights only have to be equal.
    let least = 1e-12 * chosen.iter().map(|pair| pair.y.norm()).fold(f64::MIN_POSITIVE, f64::max);
    let common = (few * (ground + height) / all).sqrt().max(least);
    if !has_vertical || heights < 4.0 {
        return [common; 2];
    }
    let [ground, height] = [ground / rows, height / heights].map(|square| (few * square).sqrt());
    // Neither is much smaller than the other: their estimates come from few positions.
    [ground.max(0.3 * common), height.max(0.3 * common)]
}

/// Umeyama's closed form (PAMI 1991); `None` if the positions lie on a line.
pub(super) fn closed_form(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Similarity3> {
    if shape(pairs.iter().map(|pair| pair.0)) < MIN_SHAPE {
        return None;
    }
    let count = pairs.len() as f64;
    let (mean_x, mean_y) =
        pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(x, y), pair| (x + pair.0, y + pair.1));
    let (mean_x, mean_y) = (mean_x / count, mean_y / count);
    let (mut covariance, mut spread) = (Matrix3::zeros(), 0.0);
    for (x, y) in pairs {
        covariance += (y - mean_y) * (x - mean_x).transpose();
        spread += (x - mean_x).norm_squared();
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * sign * v_t);
    let scale = (rotation.matrix().transpose() * covariance).trace() / spread;
    let found = Similarity3 { scale, rotation, translation: mean_y - scale * (rotation * mean_x) };
    (scale.is_finite() && scale > 0.0).then_some(found)
}

/// How far positions are from a line: the second over the first singular value of their spread.
fn shape(positions: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let positions: Vec<Vector3<f64>> = positions.collect();
    let mean = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
    let rows =
        DMatrix::from_fn(positions.len().max(3), 3, |i, j| positions.get(i).map_or(0.0, |p| p[j] - mean[j]));
    let mut values: Vec<f64> = rows.singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    if values[0] > 0.0 { values[1] / values[0] } else { 0.0 }
}

/// Samples of `N` positions: all of few, or random ones of many.
fn samples<const N: usize>(count: usize) -> Vec<[usize; N]> {
    if count < N {
        return Vec::new();
    }
    let total = (0..N).map(|k| (count - k) as f64 / (k + 1) as f64).product::<f64>();
    if total > MAX_SAMPLES as f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut draw = |_| {
            let drawn = rand::seq::index::sample(&mut rng, count, N);
            std::array::from_fn(|k| drawn.index(k))
        };
        return (0..MAX_SAMPLES).map(&mut draw).collect();
    }
    let mut all = Vec::new();
    let mut next: [usize; N] = std::array::from_fn(|k| k);
    loop {
        all.push(next);
        let Some(k) = (0..N).rev().find(|&k| next[k] < count - N + k) else { return all };
        next[k] += 1;
        for later in k + 1..N {
            next[later] = next[later - 1] + 1;
        }
    }
}
