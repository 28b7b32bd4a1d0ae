//! Descriptors of decoys: blends of the rows that are sent.
//!
//! A decoy is a row that is there, real or a decoy before it, and beside it a sum of all real rows with normal weights, in
//! parts that leave mean and covariance what they are of real rows. It is as like the row it began from as real rows are like
//! the nearest other one, and no row begins more than one. Numbers drawn each for itself from several rows, or quarters of
//! RootSIFT's, as decoys were made before, lose how numbers depend on each other: products of two numbers then tell decoys of
//! XFeat from real rows almost without fail (`tests/decoys`).
//!
//! Numbers of coarse and of unsigned kinds are far from normal. Each is given the distribution that it has in real rows, and
//! each row the length and the largest number of a real one. Coarse numbers are as good as independent: where there are
//! fewer real rows than numbers, as much of a decoy lies outside of what they span as of a real row outside of what the others
//! do, or the span would tell their count. Numbers of networks depend on each other so that all this would show: signed
//! kinds of whole bytes only get lengths.

use rand::Rng;
use rand::seq::SliceRandom as _;
use rand::seq::index::sample;
use veiloc_descriptor::{Descriptors, Encoding};

use super::normal;

/// Fewer rows say too little of how numbers depend on each other, and decoys would come near to copies.
pub(super) const FEWEST: usize = 3;
/// So many are made, though fewer be wanted: their distribution is matched as a whole.
const AT_LEAST: usize = 256;
/// Rows among which the nearest is sought, to know how alike rows are.
const LOOKED_AT: usize = 256;
/// How much nearer to 1 the cosine to the row that it began from is of unsigned kinds: what their distributions are matched
/// by takes a decoy away from it again.
const NEARER: f64 = 0.5;
/// Rounds of cutting and scaling that an unsigned row's length and largest number take.
const CUTS: usize = 8;
/// Rows that are left out in turn, to know how much of one the others do not span.
const LEFT_OUT: usize = 20;
/// A row is never more like the one that it began from.
const MOST_ALIKE: f64 = 0.98;
/// What is added, in parts of a number's usual size, to a decoy that came out as a copy.
const NOISE: f64 = 0.15;
/// Nothing is divided by less.
const TINY: f64 = 1e-9;

/// `[count]` rows made of at least [`FEWEST`] real ones.
pub(super) fn decoys<R: Rng + ?Sized>(real: &Descriptors, count: usize, rng: &mut R) -> Vec<Vec<u8>> {
    let kind = real.kind();
    let rows: Vec<Vec<f64>> =
        (0..real.len()).map(|row| real.view().values(row).map(f64::from).collect()).collect();
    let (mean, centred) = centred(rows.iter());
    let (nearer, outside) = match kind.encoding() {
        Encoding::Signed => (0.0, 0.0),
        Encoding::Unsigned => (NEARER, 0.0),
        Encoding::Coarse => (0.0, outside(&rows)),
    };
    let mut blended = blend(centred, nearer, outside, count.max(AT_LEAST), rng);
    for row in &mut blended {
        row.iter_mut().zip(&mean).for_each(|(value, mean)| *value += mean);
    }
    if kind.encoding() != Encoding::Signed {
        (0..kind.dim()).for_each(|i| match_distribution(&mut blended, &rows, i));
    }
    blended.truncate(count);
    for row in &mut blended {
        let like = &rows[rng.random_range(0..rows.len())];
        let (wanted, most) = (length(like), largest(like).1);
        bring_to(row, wanted);
        match kind.encoding() {
            Encoding::Signed => (),
            Encoding::Unsigned => cut(row, most, wanted),
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
        // Rows that are all alike blend to themselves.
        for value in &mut row {
            *value += NOISE * unit.max(1.0) * normal(rng);
        }
    };
    blended.into_iter().map(differing).collect()
}

/// `[count]` blends of rows whose mean is zero; of the sums, the part `outside` is of numbers drawn each for itself.
fn blend<R: Rng + ?Sized>(
    mut centred: Vec<Vec<f64>>,
    nearer: f64,
    outside: f64,
    count: usize,
    rng: &mut R,
) -> Vec<Vec<f64>> {
    centred.shuffle(rng);
    let alike = likeness(&centred, rng);
    let deviation = |i: usize| mean_of(centred.iter().map(|row| row[i] * row[i])).sqrt();
    let deviations: Vec<f64> = (0..centred[0].len()).map(deviation).collect();
    let mut all = centred.clone();
    for begins in 0..count {
        let part = alike[rng.random_range(0..alike.len())];
        let part = part + (1.0 - part) * nearer;
        let rest = (1.0 - part * part).sqrt();
        let weights: Vec<f64> = centred.iter().map(|_| normal(rng)).collect();
        let inside = rest * (1.0 - outside).sqrt() / length(&weights).max(TINY);
        let mut row = all[begins].clone();
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

/// What of a row lies outside of what the others span, 0 to 1, in the mean of some rows.
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
            if own > TINY * whole {
                scale(&mut direction, 1.0 / own);
                others.iter_mut().chain([&mut left]).for_each(|row| {
                    let along = dot(row, &direction);
                    row.iter_mut().zip(&direction).for_each(|(value, of)| *value -= along * of);
                });
            }
        }
        (length(&left) / whole.max(TINY)).powi(2).min(1.0)
    };
    mean_of((0..rows.len().min(LEFT_OUT)).map(of_row))
}

/// The mean, and the rows less it.
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

/// Of some rows, the cosine to the one that is most like it, 0 to [`MOST_ALIKE`].
fn likeness<R: Rng + ?Sized>(centred: &[Vec<f64>], rng: &mut R) -> Vec<f64> {
    let chosen = sample(rng, centred.len(), centred.len().min(LOOKED_AT)).into_vec();
    let directions: Vec<Vec<f64>> = (chosen.into_iter())
        .map(|row| {
            let mut direction = centred[row].clone();
            bring_to(&mut direction, 1.0);
            direction
        })
        .collect();
    let nearest = |(i, row): (usize, &Vec<f64>)| {
        let others = directions.iter().enumerate().filter(|(j, _)| i != *j);
        others.map(|(_, other)| dot(row, other)).fold(0.0, f64::max).min(MOST_ALIKE)
    };
    directions.iter().enumerate().map(nearest).collect()
}

/// Number `i` of each row becomes the one of the same rank among those of the real rows.
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

/// The largest number becomes `most` in magnitude, the others make up the rest of the length.
fn match_largest(row: &mut [f64], most: f64, wanted: f64) {
    let (place, value) = largest(row);
    let rest = (length(row).powi(2) - value * value).max(0.0).sqrt();
    let sign = row[place].signum();
    scale(row, (wanted * wanted - most * most).max(0.0).sqrt() / rest.max(TINY));
    row[place] = sign * most;
}

/// No number is larger, and the length is this; about.
fn cut(row: &mut [f64], most: f64, wanted: f64) {
    for _ in 0..CUTS {
        for value in row.iter_mut() {
            *value = value.min(most);
        }
        bring_to(row, wanted);
    }
}

/// Where the number of largest magnitude stands, and this magnitude.
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

/// To this length.
fn bring_to(row: &mut [f64], wanted: f64) {
    let own = length(row);
    scale(row, wanted / own.max(TINY));
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
