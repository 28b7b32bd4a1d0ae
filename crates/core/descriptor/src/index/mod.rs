//! An index of global descriptors: finds similar images without reading every descriptor.
//!
//! For each image the signs of its rotated codes are stored (`signs`), one bit per code, and similar images are in one
//! list (`lists`). A query is compared with the centroids of the lists, then with the first 2048 signs of the images in
//! the most similar lists, then with all signs of the best of these; the rest is to be compared code by code. The query
//! itself has three bits per code (`query_code`).
//!
//! A query that is similar to some lists and dissimilar to the rest is compared with few images; a query about equally
//! similar to all lists with eight times as many. Apart from that only the number of lists grows with the number of
//! images, as its square root. `docs/results/scale.md` has costs and recall, compared with a graph (HNSW) and exhaustive
//! search.

mod asymmetric_query;
mod centroids;

use rayon::prelude::*;

use self::asymmetric_query::AsymmetricQuery;
use self::centroids::Centroids;
use crate::GlobalDescriptor;
use crate::binary_codes::Mixing;

/// Signs of the global descriptors of a map's images.
#[derive(Clone)]
pub struct GlobalIndex {
    /// Codes of a descriptor.
    codes: usize,
    mixing: Mixing,
    /// `[N]`, the images sorted by list, within a list in their order.
    images: Vec<u32>,
    /// `[N, FIRST]`, the first words of their signs, or all if there are fewer.
    first: Vec<u64>,
    /// `[N, words - FIRST]`, the other words.
    rest: Vec<u64>,
    /// `None` for few images, which are one list.
    centroids: Option<Centroids>,
    /// `[K]`, end of each list.
    ends: Vec<usize>,
}

// As for the descriptors themselves: only the number may be logged (leak L8).
impl std::fmt::Debug for GlobalIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GlobalIndex({} of {} codes)", self.len(), self.codes)
    }
}

impl GlobalIndex {
    /// The index of these descriptors, `[N, codes]`.
    ///
    /// # Panics
    /// When `codes` is 0, `all` does not consist of whole descriptors, or there are 2³² or more.
    pub fn new(all: &[i8], codes: usize) -> Self {
        assert!(codes > 0 && all.len().is_multiple_of(codes), "whole descriptors of at least one code");
        let (mixing, words, count) = (Mixing::new(codes), codes.div_ceil(64), all.len() / codes);
        let count = u32::try_from(count).expect("fewer than 2³² descriptors");
        let mut signs = vec![0; count as usize * words];
        let rows = signs.par_chunks_exact_mut(words).zip(all.par_chunks_exact(codes));
        rows.for_each(|(own, codes)| write_signs(&mixing, codes, own));
        let centroids =
            (count >= MIN_FOR_LISTS).then(|| Centroids::of(&signs, words, 4 * count.isqrt() as usize));
        let lists = match &centroids {
            None => vec![0; count as usize],
            Some(centroids) => centroids.nearest_of(signs.par_chunks_exact(words)),
        };
        let mut ends = vec![0; centroids.as_ref().map_or(1, Centroids::len)];
        for list in &lists {
            ends[*list as usize] += 1;
        }
        let mut end = 0;
        for of_list in &mut ends {
            end += *of_list;
            *of_list = end;
        }
        let mut images: Vec<u32> = (0..count).collect();
        images.sort_by_key(|image| lists[*image as usize]);
        let in_order = |part: std::ops::Range<usize>| {
            let mut rows = vec![0; part.len() * images.len()];
            rows.par_chunks_exact_mut(part.len().max(1)).zip(&images).for_each(|(own, image)| {
                own.copy_from_slice(&signs[*image as usize * words..][part.clone()]);
            });
            rows
        };
        let (first, rest) = (in_order(0..FIRST.min(words)), in_order(FIRST.min(words)..words));
        Self { codes, mixing, images, first, rest, centroids, ends }
    }

    /// Minimum number of images for which an index saves time; for fewer, comparing all takes no longer.
    pub const MIN_IMAGES: usize = 8192;

    /// Number of images.
    pub const fn len(&self) -> usize {
        self.images.len()
    }

    /// Whether there is no image.
    pub const fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// Bytes in memory.
    pub fn byte_count(&self) -> usize {
        let words = (self.first.len() + self.rest.len()) * size_of::<u64>();
        let lists =
            self.ends.len() * size_of::<usize>() + self.centroids.as_ref().map_or(0, Centroids::byte_count);
        words + self.images.len() * size_of::<u32>() + lists
    }

    /// The number of candidates to compare code by code for the best `count`.
    pub const fn candidates_for(count: usize) -> usize {
        let some = CANDIDATES_PER_IMAGE * count;
        if some < CANDIDATES { CANDIDATES } else { some }
    }

    /// Up to `count` images most similar to the query by their signs, the most similar first, of equal ones the first;
    /// none for a query with another number of codes. See [`Self::candidates_for`] for the number to request.
    pub fn candidates(&self, query: &GlobalDescriptor, count: usize) -> Vec<usize> {
        if query.len() != self.codes {
            return Vec::new();
        }
        let words = self.codes.div_ceil(64);
        let query_code = AsymmetricQuery::new(&self.mixing, query.as_codes());
        let (first, rest) = (query_code.part(0..FIRST.min(words)), query_code.part(FIRST.min(words)..words));
        let lists = self.lists_for(&query_code, count);
        let mut distances = vec![0; lists.iter().map(|list| list.len()).sum()];
        let mut remaining = distances.as_mut_slice();
        for list in &lists {
            let (own, others) = remaining.split_at_mut(list.len());
            let width = FIRST.min(words);
            first.distances(&self.first[list.start * width..list.end * width], own);
            remaining = others;
        }
        let places: Vec<usize> =
            nearest(&distances, first.largest(), SECOND_COMPARISONS.saturating_mul(count)).collect();
        let mut second = Vec::with_capacity(places.len());
        let (mut list, mut before) = (0, 0);
        for place in places {
            while place - before >= lists[list].len() {
                before += lists[list].len();
                list += 1;
            }
            let at = lists[list].start + place - before;
            let mut distance = [0];
            let width = words - FIRST.min(words);
            rest.distances(&self.rest[at * width..][..width], &mut distance);
            second.push((distances[place] + distance[0], self.images[at]));
        }
        second.sort_unstable();
        second.truncate(count);
        second.into_iter().map(|(_, image)| image as usize).collect()
    }

    /// The lists to search for `count` candidates: those with the nearest centroids, of equal ones the first.
    fn lists_for(&self, query_code: &AsymmetricQuery, count: usize) -> Vec<std::ops::Range<usize>> {
        let list = |n: usize| n.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[n];
        let Some(centroids) = &self.centroids else { return vec![list(0)] };
        let mut distances = vec![0; centroids.len()];
        query_code.distances(centroids.rows(), &mut distances);
        let mut nearest: Vec<(u32, usize)> = distances.into_iter().zip(0..).collect();
        nearest.sort_unstable();
        // Unrelated rows have half of the maximum distance from the query.
        let half = (query_code.largest() / 2) as f64;
        let similarity = |distance: u32| half - f64::from(distance);
        let minimum = SIMILAR_SHARE * similarity(nearest[0].0);
        let (few, many) =
            (FIRST_COMPARISONS.saturating_mul(count), MAX_FIRST_COMPARISONS.saturating_mul(count));
        let mut compared = 0;
        let wanted = nearest.into_iter().take_while(|(distance, n)| {
            let wanted = compared < few || (compared < many && similarity(*distance) > minimum);
            compared += list(*n).len();
            wanted
        });
        wanted.map(|(_, n)| list(n)).collect()
    }
}

/// The indices of the `count` smallest of these distances, none above `largest`, in rising order; of equal ones the
/// first.
fn nearest(distances: &[u32], largest: usize, count: usize) -> impl Iterator<Item = usize> {
    let mut of_distance = vec![0_usize; largest + 1];
    for distance in distances {
        of_distance[*distance as usize] += 1;
    }
    let mut remaining = count;
    let limit = of_distance.iter().position(|there| {
        let fits = *there <= remaining;
        remaining -= if fits { *there } else { 0 };
        !fits
    });
    // Of those at the limit as many as still fit.
    let limit = limit.map_or(u32::MAX, |limit| limit as u32);
    distances.iter().enumerate().filter_map(move |(image, distance)| {
        let still_fits = *distance == limit && remaining > 0;
        remaining -= usize::from(still_fits);
        (*distance < limit || still_fits).then_some(image)
    })
}

fn write_signs(mixing: &Mixing, codes: &[i8], words: &mut [u64]) {
    words.fill(0);
    for (i, byte) in mixing.signs(codes).enumerate() {
        words[i / 8] |= u64::from(byte) << (8 * (i % 8));
    }
}

/// Candidates compared code by code, for each requested image,
const CANDIDATES_PER_IMAGE: usize = 30;
/// and their minimum number.
const CANDIDATES: usize = 300;
/// Words of the first comparison: 2048 signs.
const FIRST: usize = 32;
/// Images in the second comparison, for each candidate,
const SECOND_COMPARISONS: usize = 2;
/// images in the first comparison if some lists are similar,
const FIRST_COMPARISONS: usize = 28;
/// and if none is.
const MAX_FIRST_COMPARISONS: usize = 8 * FIRST_COMPARISONS;
/// A list is similar when its similarity to the query is more than this share of the largest one.
const SIMILAR_SHARE: f64 = 0.5;
/// Minimum number of images for lists; fewer images are all compared.
const MIN_FOR_LISTS: u32 = 1 << 15;

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(rng: &mut impl Rng, codes: usize) -> Vec<i8> {
        (0..codes).map(|_| rng.random_range(-60..=60)).collect()
    }

    /// The same image again, half of it changed.
    fn similar(rng: &mut impl Rng, codes: &[i8]) -> GlobalDescriptor {
        let other = random(rng, codes.len());
        GlobalDescriptor::new(codes.iter().zip(other).map(|(a, b)| a / 2 + b / 2).collect())
    }

    #[test]
    fn agrees_with_exhaustive_search() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for codes in [4096, 1088, 100] {
            let images: Vec<Vec<i8>> = (0..3000).map(|_| random(&mut rng, codes)).collect();
            let index = GlobalIndex::new(&images.concat(), codes);
            assert_eq!((index.len(), index.is_empty()), (3000, false));
            for image in [0, 17, 2999] {
                let query = similar(&mut rng, &images[image]);
                let found = index.candidates(&query, 50);
                assert_eq!(found.len(), 50);
                assert!(found[..3].contains(&image), "{image} of {codes}: {found:?}");
                let sorted = |mut all: Vec<usize>| {
                    all.sort_unstable();
                    all
                };
                let all = sorted(index.candidates(&query, 5000));
                assert_eq!(all, (0..3000).collect::<Vec<_>>(), "all of them when all are requested");
            }
        }
    }

    #[test]
    fn lists_agree_with_exhaustive_search() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let codes = 1024;
        let places: Vec<Vec<i8>> = (0..MIN_FOR_LISTS as usize / 8).map(|_| random(&mut rng, codes)).collect();
        let images: Vec<i8> = (0..MIN_FOR_LISTS as usize + 5)
            .flat_map(|i| similar(&mut rng, &places[i % places.len()]).as_codes().to_vec())
            .collect();
        let index = GlobalIndex::new(&images, codes);
        assert_eq!(
            (index.len(), index.ends.last()),
            (MIN_FOR_LISTS as usize + 5, Some(&(MIN_FOR_LISTS as usize + 5)))
        );
        let in_lists = index.byte_count() - index.len() * (codes / 8 + 4);
        assert!(in_lists > 700 * codes / 8, "{in_lists} bytes of lists");
        let mut found_same = 0;
        for place in (0..places.len()).step_by(512) {
            let query = similar(&mut rng, &places[place]);
            let compared: usize = index
                .lists_for(&AsymmetricQuery::new(&index.mixing, query.as_codes()), 20)
                .iter()
                .map(|l| l.len())
                .sum();
            // There are more places than lists here, so no list stands out: more than the minimum, and at most a tenth
            // of all.
            assert!((20 * FIRST_COMPARISONS..index.len() / 10).contains(&compared), "{compared}");
            let found = index.candidates(&query, 20);
            found_same += found.iter().filter(|image| **image % places.len() == place).count();
            let mut all = index.candidates(&query, index.len());
            all.sort_unstable();
            assert!(all.into_iter().eq(0..index.len()), "all of them when all are requested");
        }
        // Eight places with eight images each. One image in 23 is compared, so that three would be found by chance.
        assert!(found_same >= 32, "{found_same} of 64");
    }

    #[test]
    fn no_candidates_without_images_or_for_other_descriptors() {
        let empty = GlobalIndex::new(&[], 64);
        assert!(empty.is_empty() && empty.candidates(&GlobalDescriptor::new(vec![1; 64]), 10).is_empty());
        let one = GlobalIndex::new(&[1; 64], 64);
        assert!(one.candidates(&GlobalDescriptor::new(vec![1; 65]), 10).is_empty());
        assert_eq!(one.candidates(&GlobalDescriptor::new(vec![1; 64]), 10), [0]);
        assert!(one.candidates(&GlobalDescriptor::new(vec![1; 64]), 0).is_empty());
    }

    #[test]
    fn ties_go_to_the_first() {
        let found = |count| nearest(&[3, 1, 2, 1, 2, 2, 0], 3, count).collect::<Vec<_>>();
        assert_eq!(found(0), [0; 0]);
        assert_eq!(found(1), [6]);
        assert_eq!(found(2), [1, 6]);
        assert_eq!(found(4), [1, 2, 3, 6]);
        assert_eq!(found(7), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(found(70), [0, 1, 2, 3, 4, 5, 6]);
    }
}
