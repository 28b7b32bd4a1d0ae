//! How many bits differ: distances between vectors of signs.

use crate::backend::{Backend, Kind};

/// Writes to `distances` how many bits of each row differ from those of the query, `[N]`.
///
/// `rows` is `[N, query.len()]`, row by row; `distances` has N entries, and what is beyond the shorter of the two is left
/// alone. A query of no words leaves everything alone.
pub fn hamming(query: &[u64], rows: &[u64], distances: &mut [u32]) {
    hamming_on(Backend::best(), query, rows, distances);
}

fn hamming_on(backend: Backend, query: &[u64], rows: &[u64], distances: &mut [u32]) {
    match backend.kind() {
        Kind::Portable => count(query, rows, distances),
        // SAFETY: the backend's value is the evidence that the CPU has AVX2, and no CPU has AVX2 without POPCNT, which is
        // also asked for when the backend is detected.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 | Kind::Avx512Vnni => unsafe { count_popcnt(query, rows, distances) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt")]
fn count_popcnt(query: &[u64], rows: &[u64], distances: &mut [u32]) {
    count(query, rows, distances);
}

#[inline(always)]
fn count(query: &[u64], rows: &[u64], distances: &mut [u32]) {
    // Of a length that is known the loop unrolls; the first pass over all images has this one.
    if let Ok(query) = <&[u64; 8]>::try_from(query) {
        for (row, distance) in rows.as_chunks::<8>().0.iter().zip(distances) {
            let differing = query.iter().zip(row).map(|(a, b)| (a ^ b).count_ones());
            *distance = differing.sum();
        }
        return;
    }
    if query.is_empty() {
        return;
    }
    for (row, distance) in rows.chunks_exact(query.len()).zip(distances) {
        *distance = query.iter().zip(row).map(|(a, b)| (a ^ b).count_ones()).sum();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_counts() {
        let mut distances = [7; 4];
        hamming(&[0b1011, u64::MAX], &[0b1011, u64::MAX, 0, 0, 0b0100, 1], &mut distances);
        assert_eq!(distances, [0, 67, 4 + 63, 7]);
        hamming(&[], &[1, 2], &mut distances);
        assert_eq!(distances, [0, 67, 67, 7]);
    }

    proptest! {
        #[test]
        fn every_backend_counts_bits(words in 1_usize..12, rows in 0_usize..9, seed in any::<u64>()) {
            let number = |i: usize| (i as u64 + 1).wrapping_mul(seed | 1).rotate_left(i as u32 * 7);
            let query: Vec<u64> = (0..words).map(number).collect();
            let all: Vec<u64> = (100..100 + words * rows).map(number).collect();
            let expected: Vec<u32> = all
                .chunks_exact(words)
                .map(|row| (0..words * 64).filter(|b| (row[b / 64] ^ query[b / 64]) >> (b % 64) & 1 == 1).count() as u32)
                .collect();
            for backend in Backend::available() {
                let mut distances = vec![0; rows];
                hamming_on(backend, &query, &all, &mut distances);
                prop_assert_eq!(&distances, &expected, "{}", backend.name());
            }
        }
    }
}
