//! Which of many images may look like one, without reading every global descriptor.
//!
//! Of each image the signs of its rotated codes are kept (`signs`), one bit a code. The first 512 of them tell which
//! images are worth a second look, all of them which are worth comparing code by code. Nothing is learned: an index of the
//! images of one place is as good for those of another, and an image that joins changes no other.
//!
//! The first look reads 64 bytes an image where codes take some thousands, and is the only one that reads something of
//! every image. `docs/scale.md` has what that costs and loses, beside a graph (HNSW) and reading everything.

use rayon::prelude::*;
use veiloc_kernels::hamming;

use crate::GlobalDescriptor;
use crate::signs::Mixing;

/// Signs of the global descriptors of a map's images, in their order.
#[derive(Clone)]
pub struct GlobalIndex {
    /// Codes of a descriptor.
    codes: usize,
    /// Words of an image's signs.
    words: usize,
    /// `[N, FIRST]`, the first words alone, so that the first look finds them side by side.
    first: Vec<u64>,
    /// `[N, words]`
    all: Vec<u64>,
}

// As for the descriptors themselves: how many, and no more (leak L8).
impl std::fmt::Debug for GlobalIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GlobalIndex({} of {} codes)", self.len(), self.codes)
    }
}

impl GlobalIndex {
    /// Of these descriptors, `[N, codes]`.
    ///
    /// # Panics
    /// When `codes` is 0 or `all` is not made of whole descriptors.
    pub fn new(all: &[i8], codes: usize) -> Self {
        assert!(codes > 0 && all.len().is_multiple_of(codes), "whole descriptors of at least one code");
        let (mixing, words) = (Mixing::new(codes), codes.div_ceil(64));
        let mut signs = vec![0; all.len() / codes * words];
        let rows = signs.par_chunks_exact_mut(words).zip(all.par_chunks_exact(codes));
        rows.for_each(|(own, codes)| write_signs(&mixing, codes, own));
        let first = signs.chunks_exact(words).flat_map(|row| &row[..FIRST.min(words)]).copied().collect();
        Self { codes, words, first, all: signs }
    }

    /// Images from which on an index is worth its memory; of fewer, comparing all takes no longer.
    pub const WORTHWHILE: usize = 8192;

    /// Number of images.
    pub const fn len(&self) -> usize {
        self.all.len() / self.words
    }

    /// Whether there is no image.
    pub const fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Bytes in memory.
    pub const fn byte_count(&self) -> usize {
        (self.first.len() + self.all.len()) * size_of::<u64>()
    }

    /// How many candidates to compare code by code to have the best `count`.
    pub const fn candidates_for(count: usize) -> usize {
        let some = CANDIDATES_OF_EACH * count;
        if some < CANDIDATES { CANDIDATES } else { some }
    }

    /// Up to `count` images that look most like the query as far as signs tell, the most alike first, of equals the first;
    /// none for a query of another number of codes. [`Self::candidates_for`] says how many to ask for.
    pub fn candidates(&self, query: &GlobalDescriptor, count: usize) -> Vec<usize> {
        if query.len() != self.codes {
            return Vec::new();
        }
        let mut own = vec![0; self.words];
        write_signs(&Mixing::new(self.codes), query.as_codes(), &mut own);
        let first = FIRST.min(self.words);
        let mut distances = vec![0; self.len()];
        hamming(&own[..first], &self.first, &mut distances);
        let looked_at = (SECOND_LOOKS * count).max(self.len() / SECOND_SHARE);
        let mut second: Vec<(u32, usize)> = nearest(&distances, 64 * first, looked_at)
            .map(|image| {
                let mut distance = [0];
                hamming(&own, &self.all[image * self.words..][..self.words], &mut distance);
                (distance[0], image)
            })
            .collect();
        second.sort_unstable();
        second.truncate(count);
        second.into_iter().map(|(_, image)| image).collect()
    }
}

/// The `count` smallest of these distances, none above `largest`, by their indices in rising order; of equals the first.
fn nearest(distances: &[u32], largest: usize, count: usize) -> impl Iterator<Item = usize> {
    let mut of_distance = vec![0_usize; largest + 1];
    for distance in distances {
        of_distance[*distance as usize] += 1;
    }
    let mut room = count;
    let limit = of_distance.iter().position(|there| {
        let fits = *there <= room;
        room -= if fits { *there } else { 0 };
        !fits
    });
    // Of those at the limit so many as there is room for.
    let limit = limit.map_or(u32::MAX, |limit| limit as u32);
    distances.iter().enumerate().filter_map(move |(image, distance)| {
        let in_room = *distance == limit && room > 0;
        room -= usize::from(in_room);
        (*distance < limit || in_room).then_some(image)
    })
}

fn write_signs(mixing: &Mixing, codes: &[i8], words: &mut [u64]) {
    words.fill(0);
    for (i, byte) in mixing.signs(codes).enumerate() {
        words[i / 8] |= u64::from(byte) << (8 * (i % 8));
    }
}

/// For each image that is wanted so many are compared code by code,
const CANDIDATES_OF_EACH: usize = 100;
/// and so many at least.
const CANDIDATES: usize = 1000;
/// Words of the first look: 512 signs.
const FIRST: usize = 8;
/// For each image that is asked for so many have a second look,
const SECOND_LOOKS: usize = 4;
/// and at least one in so many of all: the more there are, the more look alike by chance.
const SECOND_SHARE: usize = 16;

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(rng: &mut impl Rng, codes: usize) -> Vec<i8> {
        (0..codes).map(|_| rng.random_range(-60..=60)).collect()
    }

    /// The same image seen again: half of it is something else.
    fn again(rng: &mut impl Rng, codes: &[i8]) -> GlobalDescriptor {
        let other = random(rng, codes.len());
        GlobalDescriptor::new(codes.iter().zip(other).map(|(a, b)| a / 2 + b / 2).collect())
    }

    #[test]
    fn finds_what_comparing_all_finds() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for codes in [4096, 1088, 100] {
            let images: Vec<Vec<i8>> = (0..3000).map(|_| random(&mut rng, codes)).collect();
            let index = GlobalIndex::new(&images.concat(), codes);
            assert_eq!((index.len(), index.is_empty()), (3000, false));
            for image in [0, 17, 2999] {
                let query = again(&mut rng, &images[image]);
                let found = index.candidates(&query, 50);
                assert_eq!(found.len(), 50);
                assert!(found[..3].contains(&image), "{image} of {codes}: {found:?}");
                let sorted = |mut all: Vec<usize>| {
                    all.sort_unstable();
                    all
                };
                let all = sorted(index.candidates(&query, 5000));
                assert_eq!(all, (0..3000).collect::<Vec<_>>(), "all of them when all are asked for");
            }
        }
    }

    #[test]
    fn no_images_and_other_descriptors_give_none() {
        let empty = GlobalIndex::new(&[], 64);
        assert!(empty.is_empty() && empty.candidates(&GlobalDescriptor::new(vec![1; 64]), 10).is_empty());
        let one = GlobalIndex::new(&[1; 64], 64);
        assert!(one.candidates(&GlobalDescriptor::new(vec![1; 65]), 10).is_empty());
        assert_eq!(one.candidates(&GlobalDescriptor::new(vec![1; 64]), 10), [0]);
        assert!(one.candidates(&GlobalDescriptor::new(vec![1; 64]), 0).is_empty());
    }

    #[test]
    fn the_nearest_of_equals_are_the_first() {
        let found = |count| nearest(&[3, 1, 2, 1, 2, 2, 0], 3, count).collect::<Vec<_>>();
        assert_eq!(found(0), [0; 0]);
        assert_eq!(found(1), [6]);
        assert_eq!(found(2), [1, 6]);
        assert_eq!(found(4), [1, 2, 3, 6]);
        assert_eq!(found(7), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(found(70), [0, 1, 2, 3, 4, 5, 6]);
    }
}
