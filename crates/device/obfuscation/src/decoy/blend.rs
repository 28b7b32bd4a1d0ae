//! Descriptors of decoys: blends of the rows that are sent.
//!
//! A decoy is the weighted sum of an existing row, real or decoy, and a sum of all real rows with normally distributed
//! weights. The weights preserve mean and covariance of the real rows. The similarity of a decoy to its base row is
//! drawn from the similarities of real rows to their nearest neighbours, and no row is the base of more than one decoy.
//! Drawing each dimension independently from several rows, or combining quarters of RootSIFT descriptors (the earlier
//! method), loses the dependence between dimensions: a classifier on products of two dimensions then separates decoys
//! of XFeat from real rows almost perfectly (`tests/decoys`).
//!
//! The dimensions of coarse and unsigned kinds are far from normally distributed. Each is mapped to its distribution in
//! the real rows, and each row gets the length and the largest value of a real row. The dimensions of coarse kinds are
//! nearly independent. Where there are fewer real rows than dimensions, a decoy therefore gets as large a component
//! outside of the span of the real rows as a real row has outside of the span of the others; otherwise the rank would
//! reveal the number of real rows. The dimensions of network descriptors depend on each other, and these adjustments
//! would be visible: signed kinds of full bytes only get their lengths adjusted.

use rand::Rng;
use rand::seq::SliceRandom as _;
use rand::seq::index::sample;
use veiloc_descriptor::{Descriptors, Encoding};

use super::normal;

/// Fewer rows do not determine the dependence between dimensions, and decoys would be nearly copies.
pub(super) const MIN_ROWS: usize = 3;
/// At least this many are made, even if fewer are needed: their distribution is matched as a whole.
const MIN_BLENDS: usize = 256;
/// Number of rows searched for the nearest neighbour, to estimate how similar rows are.
const NEIGHBOUR_SAMPLE: usize = 256;
/// How much the cosine to the base row is moved towards 1 for unsigned kinds: matching the distributions moves a decoy
/// away from its base row again.
const COSINE_GAIN: f64 = 0.5;
/// Iterations of clipping and scaling that give an unsigned row its length and largest value.
const CLIP_ROUNDS: usize = 8;
/// Rows that are left out in turn, to measure which part of a row the others do not span.
const HELD_OUT: usize = 20;
/// Largest cosine to the base row.
const MAX_COSINE: f64 = 0.98;
/// Noise added to a decoy that equals a real row, relative to the usual size of a value.
const NOISE: f64 = 0.15;
/// Lower bound of divisors.
const MIN_DIVISOR: f64 = 1e-9;

/// `[count]` rows made of at least [`MIN_ROWS`] real ones.
pub(super) fn decoys<R: Rng + ?Sized>(real: &Descriptors, count: usize, rng: &mut R) -> Vec<Vec<u8>> {
    let kind = real.kind();
    let rows: Vec<Vec<f64>> =
        (0..real.len()).map(|row| real.view().values(row).map(f64::from).collect()).collect();
    let (mean, centred) = centred(rows.iter());
    let (nearer, outside) = match kind.encoding() {
        Encoding::Signed => (0.0, 0.0),
        Encoding::Unsigned => (COSINE_GAIN, 0.0),
        Encoding::Coarse => (0.0, outside(&rows)),
    };
    let mut blended = blend(centred, nearer, outside, count.max(MIN_BLENDS), rng);
    for row in &mut blended {
        row.iter_mut().zip(&mean).for_each(|(value, mean)| *value += mean);
    }
    if kind.encoding() != Encoding::Signed {
        (0..kind.dim()).for_each(|i| match_distribution(&mut blended, &rows, i));
    }
    blended.truncate(count);
    for row in &mut blended {
        let reference = &rows[rng.random_range(0..rows.len())];
        let (wanted, most) = (length(reference), largest(reference).1);
        scale_to(row, wanted);
        match kind.encoding() {
            Encoding::Signed => (),
            Encoding::Unsigned => clip(row, most, wanted),
            Encoding::Coarse => match_largest(row, most, wanted),
        }
    }
    let unit = mean_of(rows.iter().map(|row| length(row))) / (kind.dim() as f64).sqrt();
    let bytes = |row: &[f64]| row.iter().map(|value| kind.encoding().byte(*value)).collect::<Vec<u8>>();
    let differing = |mut row: Vec<f64>| loop {
        let made = bytes(&row);
        if (0..real.len()).all(|other| real.row(other) != made) {
            return made;
        }
        // If all rows are equal, their blends equal them too.
        for value in &mut row {
            *value += NOISE * unit.max(1.0) * normal(rng);
        }
    };
    blended.into_iter().map(differing).collect()
}

/// `[count]` blends of centred rows; the share `outside` of each sum is independent noise per dimension.
fn blend<R: Rng + ?Sized>(
    mut centred: Vec<Vec<f64>>,
    nearer: f64,
    outside: f64,
    count: usize,
    rng: &mut R,
) -> Vec<Vec<f64>> {
    centred.shuffle(rng);
    let cosines = neighbour_cosines(&centred, rng);
    let deviation = |i: usize| mean_of(centred.iter().map(|row| row[i] * row[i])).sqrt();
    let deviations: Vec<f64> = (0..centred[0].len()).map(deviation).collect();
    let mut all = centred.clone();
    for base in 0..count {
        let part = cosines[rng.random_range(0..cosines.len())];
        let part = part + (1.0 - part) * nearer;
        let rest = (1.0 - part * part).sqrt();
        let weights: Vec<f64> = centred.iter().map(|_| normal(rng)).collect();
        let inside = rest * (1.0 - outside).sqrt() / length(&weights).max(MIN_DIVISOR);
        let mut row = all[base].clone();
        scale(&mut row, part);
        for (other, weight) in centred.iter().zip(weights) {
            row.iter_mut().zip(other).for_each(|(value, other)| *value += inside * weight * other);
        }
        if outside > 0.0 {
            let free = rest * outside.sqrt();
            row.iter_mut().zip(&deviations).for_each(|(value, of)| *value += free * of * normal(rng));
        }
        all.push(row);
    }
    all.split_off(centred.len())
}

/// The share of a row that lies outside of the span of the others, 0 to 1, averaged over some rows.
fn outside(rows: &[Vec<f64>]) -> f64 {
    if rows.len() > rows[0].len() + 1 {
        return 0.0;
    }
    let of_row = |left_out: usize| {
        let others = rows.iter().enumerate().filter(|(row, _)| *row != left_out).map(|(_, row)| row);
        let (mean, mut others) = centred(others);
        let mut left: Vec<f64> = rows[left_out].iter().zip(&mean).map(|(value, mean)| value - mean).collect();
        let whole = length(&left);
        // Gram and Schmidt.
        while let Some(mut direction) = others.pop() {
            let own = length(&direction);
            if own > MIN_DIVISOR * whole {
                scale(&mut direction, 1.0 / own);
                others.iter_mut().chain([&mut left]).for_each(|row| {
                    let along = dot(row, &direction);
                    row.iter_mut().zip(&direction).for_each(|(value, of)| *value -= along * of);
                });
            }
        }
        (length(&left) / whole.max(MIN_DIVISOR)).powi(2).min(1.0)
    };
    mean_of((0..rows.len().min(HELD_OUT)).map(of_row))
}

/// The mean, and the rows minus the mean.
fn centred<'a>(rows: impl Iterator<Item = &'a Vec<f64>> + Clone) -> (Vec<f64>, Vec<Vec<f64>>) {
    let mut mean = Vec::new();
    let mut count = 0.0;
    for row in rows.clone() {
        mean.resize(row.len(), 0.0);
        mean.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        count += 1.0;
    }
    for sum in &mut mean {
        *sum /= count;
    }
    let less = |row: &Vec<f64>| row.iter().zip(&mean).map(|(value, mean)| value - mean).collect();
    let rows = rows.map(less).collect();
    (mean, rows)
}

/// For some rows, the cosine to their nearest neighbour, 0 to [`MAX_COSINE`].
fn neighbour_cosines<R: Rng + ?Sized>(centred: &[Vec<f64>], rng: &mut R) -> Vec<f64> {
    let chosen = sample(rng, centred.len(), centred.len().min(NEIGHBOUR_SAMPLE)).into_vec();
    let directions: Vec<Vec<f64>> = (chosen.into_iter())
        .map(|row| {
            let mut direction = centred[row].clone();
            scale_to(&mut direction, 1.0);
            direction
        })
        .collect();
    let nearest = |(i, row): (usize, &Vec<f64>)| {
        let others = directions.iter().enumerate().filter(|(j, _)| i != *j);
        others.map(|(_, other)| dot(row, other)).fold(0.0, f64::max).min(MAX_COSINE)
    };
    directions.iter().enumerate().map(nearest).collect()
}

/// Replaces value `i` of each row by the value of the same rank among the real rows.
fn match_distribution(rows: &mut [Vec<f64>], real: &[Vec<f64>], i: usize) {
    let mut wanted: Vec<f64> = real.iter().map(|row| row[i]).collect();
    wanted.sort_by(f64::total_cmp);
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| rows[*a][i].total_cmp(&rows[*b][i]));
    let (last, per_row) = (wanted.len() - 1, wanted.len() as f64 / rows.len() as f64);
    for (rank, row) in order.into_iter().enumerate() {
        let at = ((rank as f64 + 0.5) * per_row - 0.5).clamp(0.0, last as f64);
        let (below, part) = (at as usize, at.fract());
        rows[row][i] = wanted[below] * (1.0 - part) + wanted[(below + 1).min(last)] * part;
    }
}

/// Sets the largest value to magnitude `most` and scales the others so that the length is `wanted`.
fn match_largest(row: &mut [f64], most: f64, wanted: f64) {
    let (index, value) = largest(row);
    let rest = (length(row).powi(2) - value * value).max(0.0).sqrt();
    let sign = row[index].signum();
    scale(row, (wanted * wanted - most * most).max(0.0).sqrt() / rest.max(MIN_DIVISOR));
    row[index] = sign * most;
}

/// Clips values to `most` and scales to length `wanted`, both approximately.
fn clip(row: &mut [f64], most: f64, wanted: f64) {
    for _ in 0..CLIP_ROUNDS {
        for value in row.iter_mut() {
            *value = value.min(most);
        }
        scale_to(row, wanted);
    }
}

/// Index of the value with the largest magnitude, and this magnitude.
fn largest(row: &[f64]) -> (usize, f64) {
    let all = row.iter().map(|value| value.abs()).enumerate();
    all.fold((0, 0.0), |best, next| if next.1 > best.1 { next } else { best })
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn length(row: &[f64]) -> f64 {
    dot(row, row).sqrt()
}

/// Scales to this length.
fn scale_to(row: &mut [f64], wanted: f64) {
    let own = length(row);
    scale(row, wanted / own.max(MIN_DIVISOR));
}

fn scale(row: &mut [f64], by: f64) {
    for value in row {
        *value *= by;
    }
}

fn mean_of(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}
