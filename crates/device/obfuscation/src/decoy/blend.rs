//! Descriptors of decoys: rotated copies of the rows that are sent.
//!
//! All real rows are copied together, as often as needed. A copy is rotated about the mean of the rows: by a random
//! rotation within each group of [`GROUP`] neighbouring principal components, after which every component gets its
//! variance back. So decoys have the mean and the covariance of the real rows, and two decoys of one copy are about as
//! similar to each other as the two rows that they are copies of: each has its nearest rows, and these lie where the
//! nearest rows of a real row lie ([`super::add`] places every decoy near the row that it is a copy of). A decoy is no
//! more similar to its own row than to any other.
//! Two other methods are worse. Drawing each dimension independently from several rows, or combining quarters of
//! RootSIFT descriptors, loses the dependence between dimensions: a classifier on products of two dimensions then
//! separates decoys of XFeat from real rows almost perfectly. Making every decoy on its own, as a blend of one row and a
//! random sum of all rows, loses the neighbours of a row: descriptors and angles together then separate them
//! (`tests/decoys`).
//!
//! The dimensions of coarse and unsigned kinds are far from normally distributed. Each is mapped to its distribution in
//! the real rows, and each row gets the length and the largest value of a real row. The dimensions of coarse kinds are
//! nearly independent. Where there are fewer real rows than dimensions, a decoy therefore gets as large a component
//! outside of the span of the real rows as a real row has outside of the span of the others; otherwise the rank would
//! reveal the number of real rows. The dimensions of network descriptors depend on each other, and these adjustments
//! would be visible: signed kinds of full bytes only get their lengths adjusted.

use std::collections::BTreeMap;

use rand::Rng;
use rand::seq::SliceRandom as _;
use veiloc_descriptor::{Descriptors, Encoding};
use veiloc_geometry::nalgebra::{DMatrix, SymmetricEigen};

use super::normal;

/// Fewer rows do not determine the dependence between dimensions, and decoys would be nearly copies.
pub(super) const MIN_ROWS: usize = 3;
/// Principal components that are rotated together. Turning only signs would keep the magnitude of each component, which
/// would show whose copy a decoy is; turning all would lose the covariance.
const GROUP: usize = 8;
/// How often the nearest row of a chosen row is chosen too, where only a part of a copy is needed. Always would prefer
/// rows that are each other's nearest, never would leave out the nearest rows of most.
const WITH_NEAREST: f64 = 0.7;
/// Share of the part outside of the span of the real rows for which all copies have one rotation in common. With one of
/// its own each, rows would have too little in common with rows of other copies; with the same, too much.
const SHARED: f64 = 0.4;
/// How far a row is moved towards its nearest row for unsigned kinds: matching the distributions moves it away again.
const NEARER: f64 = 0.1;
/// Iterations of clipping and scaling that give an unsigned row its length and largest value.
const CLIP_ROUNDS: usize = 8;
/// Rows that are left out in turn, to measure which part of a row the others do not span.
const HELD_OUT: usize = 20;
/// Smallest principal component that is rotated, relative to the largest.
const MIN_COMPONENT: f64 = 1e-9;
/// Noise added to a decoy that equals a real row, relative to the usual size of a value.
const NOISE: f64 = 0.15;
/// Lower bound of divisors.
const MIN_DIVISOR: f64 = 1e-9;

/// The descriptor of a decoy.
pub(super) struct Decoy {
    pub(super) row: Vec<u8>,
    /// The real row that it is a copy of.
    pub(super) origin: usize,
    /// Which copy it belongs to.
    pub(super) copy: usize,
}

/// `[count]` decoys made of at least [`MIN_ROWS`] real rows; `position_of` tells which of these share a position.
pub(super) fn decoys<R: Rng + ?Sized>(
    real: &Descriptors,
    position_of: &[usize],
    count: usize,
    rng: &mut R,
) -> Vec<Decoy> {
    let kind = real.kind();
    let rows: Vec<Vec<f64>> =
        (0..real.len()).map(|row| real.view().values(row).map(f64::from).collect()).collect();
    let (mean, centred) = centred(rows.iter());
    let outside = if kind.encoding() == Encoding::Coarse { outside(&rows) } else { 0.0 };
    let nearest = nearest(&centred);
    let nearer = if kind.encoding() == Encoding::Unsigned { NEARER } else { 0.0 };
    let mut copies = copies(&centred, outside, count.div_ceil(rows.len()), rng);
    if nearer > 0.0 {
        for copy in copies.chunks_mut(rows.len()) {
            let before = copy.to_vec();
            for (row, nearest) in copy.iter_mut().zip(&nearest) {
                row.iter_mut()
                    .zip(&before[*nearest])
                    .for_each(|(value, other)| *value += nearer * (other - *value));
            }
        }
    }
    for row in &mut copies {
        row.iter_mut().zip(&mean).for_each(|(value, mean)| *value += mean);
    }
    if kind.encoding() != Encoding::Signed {
        (0..kind.dim()).for_each(|i| match_distribution(&mut copies, &rows, i));
    }
    let unit = mean_of(rows.iter().map(|row| length(row))) / (kind.dim() as f64).sqrt();
    let bytes = |row: &[f64]| row.iter().map(|value| kind.encoding().byte(*value)).collect::<Vec<u8>>();
    let mut made = Vec::with_capacity(count);
    for (copy, rows_of_copy) in copies.chunks(rows.len()).enumerate() {
        for origin in chosen(position_of, &nearest, count - made.len(), rng) {
            let mut row = rows_of_copy[origin].clone();
            let reference = &rows[rng.random_range(0..rows.len())];
            let (wanted, most) = (length(reference), largest(reference).1);
            scale_to(&mut row, wanted);
            match kind.encoding() {
                Encoding::Signed => (),
                Encoding::Unsigned => clip(&mut row, most, wanted),
                Encoding::Coarse => match_largest(&mut row, most, wanted),
            }
            let row = loop {
                let made = bytes(&row);
                if (0..real.len()).all(|other| real.row(other) != made) {
                    break made;
                }
                // If all rows are equal, their copies equal them too.
                for value in &mut row {
                    *value += NOISE * unit.max(1.0) * normal(rng);
                }
            };
            made.push(Decoy { row, origin, copy });
        }
    }
    made
}

/// Rotated copies of centred rows, `[copies * rows]`; of each, the share `outside` is rotated out of their span.
fn copies<R: Rng + ?Sized>(centred: &[Vec<f64>], outside: f64, copies: usize, rng: &mut R) -> Vec<Vec<f64>> {
    let (rows, dim) = (centred.len(), centred[0].len());
    let all = DMatrix::from_fn(rows, dim, |i, j| centred[i][j]);
    let eigen = SymmetricEigen::new(&all * all.transpose());
    let largest = eigen.eigenvalues.max();
    let mut order: Vec<usize> =
        (0..rows).filter(|i| eigen.eigenvalues[*i] > MIN_COMPONENT * largest.max(MIN_DIVISOR)).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let sizes: Vec<f64> = order.iter().map(|i| eigen.eigenvalues[*i].sqrt()).collect();
    // Rows by principal components, and the components themselves.
    let parts = DMatrix::from_fn(rows, order.len(), |i, j| eigen.eigenvectors[(i, order[j])] * sizes[j]);
    let directions =
        DMatrix::from_fn(order.len(), rows, |j, i| eigen.eigenvectors[(i, order[j])] / sizes[j]) * &all;
    let deviations: Vec<f64> =
        all.column_iter().map(|column| (column.norm_squared() / rows as f64).sqrt()).collect();
    let usual = (mean_of(deviations.iter().map(|d| d * d))).sqrt().max(MIN_DIVISOR);
    let common = if outside > 0.0 { rotation(dim, rng) } else { DMatrix::zeros(0, 0) };
    let mut made = Vec::with_capacity(copies * rows);
    for _ in 0..copies {
        let mut rotated = parts.clone();
        for first in (0..order.len()).step_by(GROUP) {
            let width = GROUP.min(order.len() - first);
            let group = parts.columns(first, width) * rotation(width, rng);
            for (j, column) in group.column_iter().enumerate() {
                let restored = column * (sizes[first + j] / column.norm().max(MIN_DIVISOR));
                rotated.set_column(first + j, &restored);
            }
        }
        let mut copy = rotated * &directions;
        if outside > 0.0 {
            let own = &all * rotation(dim, rng);
            let mut free = (&copy * &common) * SHARED.sqrt() + own * (1.0 - SHARED).sqrt();
            for (mut column, deviation) in free.column_iter_mut().zip(&deviations) {
                column *= outside.sqrt() * deviation / usual;
            }
            copy = copy * (1.0 - outside).sqrt() + free;
        }
        made.extend(copy.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>()));
    }
    made
}

/// A random rotation or reflection.
fn rotation<R: Rng + ?Sized>(dim: usize, rng: &mut R) -> DMatrix<f64> {
    let (q, r) = DMatrix::from_fn(dim, dim, |_, _| normal(rng)).qr().unpack();
    // With these signs all rotations are equally likely.
    let signs = DMatrix::from_diagonal(&r.diagonal().map(f64::signum));
    q * signs
}

/// At most `count` rows of a copy. Where these are not all: rows with those at the same position, and often with the
/// nearest row of a row, so that most decoys keep theirs.
fn chosen<R: Rng + ?Sized>(
    position_of: &[usize],
    nearest: &[usize],
    count: usize,
    rng: &mut R,
) -> Vec<usize> {
    let rows = position_of.len();
    if count >= rows {
        return (0..rows).collect();
    }
    let mut at: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (row, position) in position_of.iter().enumerate() {
        at.entry(*position).or_default().push(row);
    }
    let mut starts: Vec<usize> = at.keys().copied().collect();
    starts.shuffle(rng);
    let (mut chosen, mut is_chosen) = (Vec::new(), vec![false; rows]);
    for start in starts {
        let same = &at[&start];
        let mut row = same[rng.random_range(0..same.len())];
        while !is_chosen[row] && chosen.len() < count {
            for other in &at[&position_of[row]] {
                is_chosen[*other] = true;
                chosen.push(*other);
            }
            if rng.random::<f64>() < WITH_NEAREST {
                row = nearest[row];
            }
        }
    }
    chosen.truncate(count);
    chosen
}

/// For each centred row, the row with the largest cosine to it.
fn nearest(centred: &[Vec<f64>]) -> Vec<usize> {
    let lengths: Vec<f64> = centred.iter().map(|row| length(row).max(MIN_DIVISOR)).collect();
    let cosine = |a: usize, b: usize| dot(&centred[a], &centred[b]) / lengths[b];
    (0..centred.len())
        .map(|row| {
            let others = (0..centred.len()).filter(|other| *other != row);
            others.max_by(|a, b| cosine(row, *a).total_cmp(&cosine(row, *b))).unwrap_or(row)
        })
        .collect()
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
