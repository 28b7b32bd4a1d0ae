//! Lists of similar images: a query is compared with the images of some lists, of which the share falls with the number
//! of images.
//!
//! Each list has a centroid, a vector of signs like those of images: each sign is the majority among its images
//! (k-majority; Grana and others, *A fast approach for integrating ORB descriptors in the bag of words model*, SPIE
//! 2013). All in integers and without randomness: equal images give equal lists for any number of threads.

use rayon::prelude::*;
use veiloc_simd::hamming;

/// The centroids of lists.
#[derive(Clone)]
pub(super) struct Centroids {
    words: usize,
    /// `[K, words]`
    all: Vec<u64>,
    /// `[K, FIRST]`, the first words only: enough to find the centroids that may be near.
    first: Vec<u64>,
}

impl Centroids {
    /// `count` centroids of signs `[N, words]`: initially evenly spaced images, then several rounds in which each
    /// becomes the majority of the images nearest to it.
    pub(super) fn of(signs: &[u64], words: usize, count: usize) -> Self {
        let images = signs.len() / words;
        // A sample of evenly spaced images.
        let row = |i: usize, of: usize| &signs[i * images / of * words..][..words];
        let mut centroids = Self::new(words, (0..count).flat_map(|i| row(i, count)).copied().collect());
        for samples in ROUNDS {
            let samples = images.min(samples * count);
            let row = |i: usize| row(i, samples);
            let mut of_centroid = vec![Vec::new(); count];
            let lists = centroids.nearest_of((0..samples).into_par_iter().map(row));
            for (sample, list) in lists.into_iter().enumerate() {
                of_centroid[list as usize].push(sample);
            }
            let mut all = centroids.all;
            all.par_chunks_exact_mut(words).zip(&of_centroid).for_each(|(centroid, samples)| {
                majority(centroid, samples.iter().map(|sample| row(*sample)));
            });
            centroids = Self::new(words, all);
        }
        centroids
    }

    fn new(words: usize, all: Vec<u64>) -> Self {
        let first = all.chunks_exact(words).flat_map(|row| &row[..FIRST.min(words)]).copied().collect();
        Self { words, all, first }
    }

    /// All centroids, `[K, words]`.
    pub(super) fn rows(&self) -> &[u64] {
        &self.all
    }

    /// Number of lists.
    pub(super) const fn len(&self) -> usize {
        self.all.len() / self.words
    }

    /// Bytes in memory.
    pub(super) const fn byte_count(&self) -> usize {
        (self.all.len() + self.first.len()) * size_of::<u64>()
    }

    /// The list of each row of signs, in the order of the rows.
    pub(super) fn nearest_of<'a>(&self, rows: impl IndexedParallelIterator<Item = &'a [u64]>) -> Vec<u32> {
        rows.map_init(|| vec![0; self.len()], |scratch, row| self.nearest(row, scratch)).collect()
    }

    /// The nearest centroid by Hamming distance, of equal ones the first. Only centroids whose first signs are about as
    /// near as the nearest are compared completely; the others are very rarely nearer.
    fn nearest(&self, row: &[u64], scratch: &mut [u32]) -> u32 {
        let first = FIRST.min(self.words);
        hamming(&row[..first], &self.first, scratch);
        let near = scratch.iter().min().copied().unwrap_or(0) + MARGIN;
        let mut best = (u32::MAX, 0);
        for (list, distance) in (0..).zip(scratch.iter()) {
            if *distance <= near {
                let mut whole = [0];
                hamming(row, &self.all[list as usize * self.words..][..self.words], &mut whole);
                best = best.min((whole[0], list));
            }
        }
        best.1
    }
}

/// Makes a centroid the majority of these rows; ties keep the old sign, and so does an empty list.
fn majority<'a>(centroid: &mut [u64], rows: impl Iterator<Item = &'a [u64]>) {
    // Number of rows with each sign, in binary: the first plane has the lowest bits, the next the second bits.
    let mut planes: Vec<Vec<u64>> = Vec::new();
    let mut count = 0_u32;
    let mut carried = vec![0; centroid.len()];
    for row in rows {
        count += 1;
        carried.copy_from_slice(row);
        for plane in &mut planes {
            for (bits, carry) in plane.iter_mut().zip(&mut carried) {
                (*bits, *carry) = (*bits ^ *carry, *bits & *carry);
            }
        }
        if carried.iter().any(|bits| *bits != 0) {
            planes.push(carried.clone());
        }
    }
    for (word, signs) in centroid.iter_mut().enumerate() {
        for bit in 0..64 {
            let have = planes.iter().rev().fold(0_u32, |n, plane| 2 * n + (plane[word] >> bit & 1) as u32);
            match (2 * have).cmp(&count) {
                std::cmp::Ordering::Less => *signs &= !(1 << bit),
                std::cmp::Ordering::Equal => {}
                std::cmp::Ordering::Greater => *signs |= 1 << bit,
            }
        }
    }
}

/// For each round of learning the maximum number of images per centroid: early rounds move centroids far in any case.
const ROUNDS: [usize; 5] = [16, 16, 32, 32, 64];
/// Words that are used to find the near centroids: 512 signs.
const FIRST: usize = 8;
/// Maximum difference in these signs between the nearest centroid and another: the standard deviation by chance is
/// eleven.
const MARGIN: u32 = 14;

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn majorities_are_counted() {
        let rows: [&[u64]; 5] = [&[0b1110], &[0b0110], &[0b0010], &[0b0010], &[0b0110]];
        let mut centroid = [0b1001];
        majority(&mut centroid, rows.into_iter());
        assert_eq!(centroid, [0b0110]);
        majority(&mut centroid, rows[1..].iter().copied());
        assert_eq!(centroid, [0b0110], "the third sign has a tie and stays");
        let mut none = [0b1001];
        majority(&mut none, rows[..0].iter().copied());
        assert_eq!(none, [0b1001]);
    }

    /// Twenty groups of signs, each with an eighth of the signs of its own row flipped.
    fn groups(words: usize) -> Vec<u64> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let own: Vec<u64> = (0..20 * words).map(|_| rng.random()).collect();
        let mut rows = Vec::new();
        for image in 0..600 {
            let group = image * 7 % 20;
            let flips =
                |rng: &mut ChaCha8Rng| rng.random::<u64>() & rng.random::<u64>() & rng.random::<u64>();
            rows.extend(own[group * words..][..words].iter().map(|word| word ^ flips(&mut rng)));
        }
        rows
    }

    #[test]
    fn similar_images_share_a_list_for_any_thread_count() {
        let words = 24;
        let rows = groups(words);
        let listed = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| {
                let centroids = Centroids::of(&rows, words, 20);
                let lists = centroids.nearest_of(rows.par_chunks_exact(words));
                (centroids.all, lists)
            })
        };
        let (centroids, lists) = listed(1);
        assert_eq!((&centroids, &lists), (&listed(3).0, &listed(3).1));
        // Centroids start as images, so some groups have two lists and some share one; no list mixes parts of groups.
        let pure = (0..20).filter(|group| {
            let of = |image: &usize| lists[*image];
            let own: Vec<usize> = (0..600).filter(|image| image * 7 % 20 == *group).collect();
            own.iter().all(|image| of(image) == of(&own[0]))
        });
        assert!(pure.count() >= 14);
    }
}
