//! Which of many images may look like one, without reading every global descriptor.
//!
//! Of each image the signs of its rotated codes are kept (`signs`), one bit a code, and images that look alike lie in one list
//! (`lists`). A query is compared with the centroids of the lists, then with the first 2048 signs of the images of the lists
//! that are most like it, then with all signs of the best of these; what remains is worth comparing code by code. A query is
//! not made signs for that: three bits of each of its codes are (`query_code`).
//!
//! A query that is like some lists and unlike the rest looks at few images. One that all lists are about as unlike as each
//! other looks at eight times as many. Beyond that nothing grows with the number of images but the number of lists, which
//! grows with its square root. `docs/results/scale.md` has what that costs and loses, beside a graph (HNSW) and reading everything.

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
    /// `[N]`, the images list by list, within a list in their order.
    images: Vec<u32>,
    /// `[N, FIRST]`, the first words of their signs, as many as there are.
    first: Vec<u64>,
    /// `[N, words - FIRST]`, the others.
    rest: Vec<u64>,
    /// None of few images, which are one list.
    centroids: Option<Centroids>,
    /// `[K]`, where each list ends.
    ends: Vec<usize>,
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
    /// When `codes` is 0 or `all` is not made of whole descriptors, or when there are 2³² and more.
    pub fn new(all: &[i8], codes: usize) -> Self {
        assert!(codes > 0 && all.len().is_multiple_of(codes), "whole descriptors of at least one code");
        let (mixing, words, count) = (Mixing::new(codes), codes.div_ceil(64), all.len() / codes);
        let count = u32::try_from(count).expect("fewer than 2³² descriptors");
        let mut signs = vec![0; count as usize * words];
        let rows = signs.par_chunks_exact_mut(words).zip(all.par_chunks_exact(codes));
        rows.for_each(|(own, codes)| write_signs(&mixing, codes, own));
        let centroids = (count >= LISTED).then(|| Centroids::of(&signs, words, 4 * count.isqrt() as usize));
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

    /// Images from which on an index is worth its memory; of fewer, comparing all takes no longer.
    pub const WORTHWHILE: usize = 8192;

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
        let words = self.codes.div_ceil(64);
        let query_code = AsymmetricQuery::new(&self.mixing, query.as_codes());
        let (first, rest) = (query_code.part(0..FIRST.min(words)), query_code.part(FIRST.min(words)..words));
        let lists = self.lists_for(&query_code, count);
        let mut distances = vec![0; lists.iter().map(|list| list.len()).sum()];
        let mut room = distances.as_mut_slice();
        for list in &lists {
            let (own, others) = room.split_at_mut(list.len());
            let width = FIRST.min(words);
            first.distances(&self.first[list.start * width..list.end * width], own);
            room = others;
        }
        let places: Vec<usize> =
            nearest(&distances, first.largest(), SECOND_LOOKS.saturating_mul(count)).collect();
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

    /// The lists to search for `count` candidates: those with the nearest centroids, of equals the first.
    fn lists_for(&self, query_code: &AsymmetricQuery, count: usize) -> Vec<std::ops::Range<usize>> {
        let list = |n: usize| n.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[n];
        let Some(centroids) = &self.centroids else { return vec![list(0)] };
        let mut distances = vec![0; centroids.len()];
        query_code.distances(centroids.rows(), &mut distances);
        let mut nearest: Vec<(u32, usize)> = distances.into_iter().zip(0..).collect();
        nearest.sort_unstable();
        // Rows that have nothing in common with the query are half of the way to its opposite from it.
        let half = (query_code.largest() / 2) as f64;
        let alike = |distance: u32| half - f64::from(distance);
        let enough = STANDING_OUT * alike(nearest[0].0);
        let (few, many) = (LOOKS.saturating_mul(count), MOST_LOOKS.saturating_mul(count));
        let mut looked_at = 0;
        let wanted = nearest.into_iter().take_while(|(distance, n)| {
            let wanted = looked_at < few || (looked_at < many && alike(*distance) > enough);
            looked_at += list(*n).len();
            wanted
        });
        wanted.map(|(_, n)| list(n)).collect()
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
const CANDIDATES_OF_EACH: usize = 30;
/// and so many at least.
const CANDIDATES: usize = 300;
/// Words of the first look: 2048 signs.
const FIRST: usize = 32;
/// For each candidate so many images have a second look,
const SECOND_LOOKS: usize = 2;
/// so many the first look where some lists stand out,
const LOOKS: usize = 28;
/// and so many where none does.
const MOST_LOOKS: usize = 8 * LOOKS;
/// A list stands out when it is more than so much as like the query as the list is that is most like it.
const STANDING_OUT: f64 = 0.5;
/// Images from which on they lie in lists; fewer are looked at all.
const LISTED: u32 = 1 << 15;

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
    fn finds_in_lists_what_comparing_all_finds() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let codes = 1024;
        let places: Vec<Vec<i8>> = (0..LISTED as usize / 8).map(|_| random(&mut rng, codes)).collect();
        let images: Vec<i8> = (0..LISTED as usize + 5)
            .flat_map(|i| again(&mut rng, &places[i % places.len()]).as_codes().to_vec())
            .collect();
        let index = GlobalIndex::new(&images, codes);
        assert_eq!((index.len(), index.ends.last()), (LISTED as usize + 5, Some(&(LISTED as usize + 5))));
        let in_lists = index.byte_count() - index.len() * (codes / 8 + 4);
        assert!(in_lists > 700 * codes / 8, "{in_lists} bytes of lists");
        let mut kept = 0;
        for place in (0..places.len()).step_by(512) {
            let query = again(&mut rng, &places[place]);
            let looked_at: usize = index
                .lists_for(&AsymmetricQuery::new(&index.mixing, query.as_codes()), 20)
                .iter()
                .map(|l| l.len())
                .sum();
            // Places outnumber lists here, so no list stands out far: more than the least, and no more than a tenth of all.
            assert!((20 * LOOKS..index.len() / 10).contains(&looked_at), "{looked_at}");
            let found = index.candidates(&query, 20);
            kept += found.iter().filter(|image| **image % places.len() == place).count();
            let mut all = index.candidates(&query, index.len());
            all.sort_unstable();
            assert!(all.into_iter().eq(0..index.len()), "all of them when all are asked for");
        }
        // Of eight places eight images each. One in twenty-three is looked at, so that chance would keep three.
        assert!(kept >= 32, "{kept} of 64");
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
