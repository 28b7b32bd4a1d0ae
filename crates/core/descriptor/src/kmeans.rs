//! K-means over byte vectors, in integers: the same centroids on every machine and for every number of threads.

use std::cmp::Reverse;

use rand::Rng;
use rayon::prelude::*;
use veiloc_simd::{Backend, PackedRows, dot_u8};

use crate::{DescriptorError, DescriptorView, neighbours::nearest_rows};

/// Maximum number of rounds of assignment and update; gains after 20 rounds are below a percent of the total distance.
const MAX_ROUNDS: usize = 30;

/// Samples summed at once by one thread. Integer sums do not depend on the grouping.
const CHUNK: usize = 4096;

/// `k` centroids of the samples `[N, dim]`, row by row `[k, dim]`.
///
/// Seeds by k-means++ (each next centroid is a sample, drawn with probability proportional to its squared distance to
/// the nearest centroid so far), then Lloyd's rounds. Centroids are rounded to bytes in every round, so that the
/// rounded ones are optimized. A centroid without samples moves to the sample farthest from its own centroid.
///
/// # Errors
/// [`DescriptorError::TooFewSamples`] for fewer than `k` distinct samples.
pub(crate) fn train(
    samples: DescriptorView<'_>,
    k: usize,
    rng: &mut impl Rng,
) -> Result<Vec<u8>, DescriptorError> {
    let mut centroids = seeds(samples, k, rng)?;
    for _ in 0..MAX_ROUNDS {
        let next = lloyd_round(samples, &centroids);
        if next == centroids {
            break;
        }
        centroids = next;
    }
    Ok(centroids)
}

fn seeds(samples: DescriptorView<'_>, k: usize, rng: &mut impl Rng) -> Result<Vec<u8>, DescriptorError> {
    let dim = samples.kind().dim();
    let too_few = |distinct| DescriptorError::TooFewSamples { samples: samples.len(), distinct, words: k };
    if samples.is_empty() {
        return Err(too_few(0));
    }
    let mut centroids = Vec::with_capacity(k * dim);
    let mut distances = vec![u64::MAX; samples.len()];
    let mut chosen = rng.random_range(0..samples.len());
    loop {
        let seed = samples.row(chosen);
        centroids.extend_from_slice(seed);
        if centroids.len() == k * dim {
            return Ok(centroids);
        }
        samples.as_bytes().par_chunks_exact(dim).zip(&mut distances).for_each(|(row, nearest)| {
            *nearest = (*nearest).min(squared_distance(row, seed));
        });
        let total: u64 = distances.iter().sum();
        if total == 0 {
            return Err(too_few(centroids.len() / dim)); // every sample is one of the seeds
        }
        let mut left = rng.random_range(0..total);
        chosen = distances
            .iter()
            .position(|&d| {
                let here = left < d;
                left = left.saturating_sub(d);
                here
            })
            .expect("the draw is below the sum of the distances");
    }
}

fn squared_distance(a: &[u8], b: &[u8]) -> u64 {
    u64::from(dot_u8(a, a)) + u64::from(dot_u8(b, b)) - 2 * u64::from(dot_u8(a, b))
}

/// One of Lloyd's rounds.
pub(crate) fn lloyd_round(samples: DescriptorView<'_>, centroids: &[u8]) -> Vec<u8> {
    let dim = samples.kind().dim();
    let packed = PackedRows::new(Backend::best(), centroids, dim);
    let nearest = nearest_rows(samples.as_bytes(), &packed);
    let rows = samples.as_bytes().par_chunks(CHUNK * dim);
    let partial: Vec<Sums> = rows
        .zip(nearest.par_chunks(CHUNK))
        .map(|(rows, nearest)| {
            let mut sums = Sums::new(centroids.len() / dim, dim);
            for (row, two) in rows.chunks_exact(dim).zip(nearest) {
                if let Some(two) = two {
                    sums.add(two.nearest.index as usize, row);
                }
            }
            sums
        })
        .collect();
    let mut sums = Sums::new(centroids.len() / dim, dim);
    for part in &partial {
        sums.merge(part);
    }

    let mut next = centroids.to_vec();
    // Nearest last, and of equally far ones the lowest index last: `pop` gives the farthest.
    let mut farthest: Vec<(u32, Reverse<usize>)> = Vec::new();
    if sums.counts.contains(&0) {
        let distances = nearest.iter().enumerate();
        farthest = distances.filter_map(|(i, n)| Some((n.as_ref()?.nearest.distance, Reverse(i)))).collect();
        farthest.sort_unstable();
    }
    let sums_and_counts = sums.components.chunks_exact(dim).zip(&sums.counts);
    for (centroid, (sum, &count)) in next.chunks_exact_mut(dim).zip(sums_and_counts) {
        for (value, &sum) in centroid.iter_mut().zip(sum) {
            *value = (sum + count / 2).checked_div(count).map_or(*value, |mean| mean as u8); // a mean of bytes is one
        }
        if count == 0
            && let Some((_, Reverse(sample))) = farthest.pop()
        {
            centroid.copy_from_slice(samples.row(sample));
        }
    }
    next
}

/// Component sums `[k, dim]` and counts `[k]` of the samples nearest to each centroid.
struct Sums {
    dim: usize,
    components: Vec<u64>,
    counts: Vec<u64>,
}

impl Sums {
    fn new(k: usize, dim: usize) -> Self {
        Self { dim, components: vec![0; k * dim], counts: vec![0; k] }
    }

    fn add(&mut self, centroid: usize, row: &[u8]) {
        self.counts[centroid] += 1;
        let sums = &mut self.components[centroid * self.dim..][..self.dim];
        for (sum, &value) in sums.iter_mut().zip(row) {
            *sum += u64::from(value);
        }
    }

    fn merge(&mut self, other: &Self) {
        for (sum, value) in self.components.iter_mut().zip(&other.components) {
            *sum += value;
        }
        for (count, value) in self.counts.iter_mut().zip(&other.counts) {
            *count += value;
        }
    }
}
