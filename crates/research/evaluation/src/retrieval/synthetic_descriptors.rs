//! Synthetic global descriptors, for databases larger than the available images.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Extends `[N, codes]` global descriptors to `count`; each new one is composed of existing ones.
///
/// The block of each visual word comes from one of three images, drawn for the new descriptor: blocks look like those
/// of images, and blocks from the same image are correlated as in images. Each number is changed by up to an eighth
/// of its size, so no two blocks are equal.
///
/// The result does not depend on the number of threads.
pub(crate) fn extend_with_synthetic(
    all: &mut Vec<i8>,
    (codes, block): (usize, usize),
    count: usize,
    seed: u64,
) {
    let there = all.len() / codes;
    if there == 0 || count <= there {
        return;
    }
    let mut new = vec![0_i8; (count - there) * codes];
    new.par_chunks_exact_mut(codes).enumerate().for_each(|(n, own)| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let parents: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..there));
        for (start, word) in (0..).step_by(block).zip(own.chunks_mut(block)) {
            let parent = parents[rng.random_range(0..parents.len())] * codes + start;
            let noise = rng.random::<u64>();
            for (i, (code, from)) in word.iter_mut().zip(&all[parent..]).enumerate() {
                // Three bits per code: from -4 to 3 parts in 32.
                let part = i16::from((noise.rotate_left(3 * i as u32 + i as u32 / 21) & 7) as u8) - 4;
                *code = (i16::from(*from) + i16::from(*from) * part / 32) as i8;
            }
        }
    });
    all.append(&mut new);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_come_from_images_and_are_independent_of_threads() {
        let real: Vec<i8> = (0..6 * 8).map(|i| if i / 8 % 2 == 0 { 100 } else { -60 }).collect();
        let grown = |threads: usize| {
            let mut all = real.clone();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| extend_with_synthetic(&mut all, (8, 4), 50, 3));
            all
        };
        let all = grown(1);
        assert_eq!((all.len(), &all[..real.len()], &all), (50 * 8, &real[..], &grown(3)));
        for block in all.chunks(4) {
            let near = |center: i8| block.iter().all(|c| (i16::from(*c) - i16::from(center)).abs() <= 13);
            assert!(near(100) || near(-60), "{block:?}");
        }
        let mixed = all.chunks(8).filter(|own| (own[0] > 0) != (own[4] > 0)).count();
        assert!(mixed > 5, "{mixed}");
    }

    #[test]
    fn empty_input_gives_no_descriptors() {
        let mut none = Vec::new();
        extend_with_synthetic(&mut none, (8, 4), 10, 0);
        assert!(none.is_empty());
    }
}
