//! Hamming distances between vectors of signs, and distances from numbers of a few bits to signs.

use crate::backend::{Backend, Kind};

/// Writes to `distances` the number of bits of each row that differ from the query, `[N]`.
///
/// `rows` is `[N, query.len()]`, row by row; `distances` has N entries; if their lengths differ, the rest of the longer
/// one is ignored. An empty query changes nothing.
pub fn hamming(query: &[u64], rows: &[u64], distances: &mut [u32]) {
    hamming_on(Backend::best(), query, rows, distances);
}

/// Writes to `distances` the distances of numbers of three bits from the signs of each row, `[N]`: the sum of absolute
/// differences, where a 0 bit counts as 0 and a 1 bit as 7.
///
/// `planes` is `[3, words]`: the lowest, second and third bit of every number. `rows` is `[N, words]`. Otherwise like
/// [`hamming`].
///
/// # Panics
/// When the length of `planes` is not three times `words`.
pub fn hamming_of_three_bits(planes: &[u64], words: usize, rows: &[u64], distances: &mut [u32]) {
    three_bits_on(Backend::best(), planes, words, rows, distances);
}

fn hamming_on(backend: Backend, query: &[u64], rows: &[u64], distances: &mut [u32]) {
    // The loop is unrolled for known lengths, which the passes over all rows have.
    match query.len() {
        0 => {}
        8 => run(backend, OfLength::<1, 8>([query.as_chunks().0[0]]), rows, distances),
        64 => run(backend, OfLength::<1, 64>([query.as_chunks().0[0]]), rows, distances),
        _ => run(backend, OfAnyLength([query]), rows, distances),
    }
}

fn three_bits_on(backend: Backend, planes: &[u64], words: usize, rows: &[u64], distances: &mut [u32]) {
    assert!(planes.len() == 3 * words, "{} words of three planes of {words}", planes.len());
    if words == 0 {
        return;
    }
    let planes = [0, 1, 2].map(|bit| &planes[bit * words..][..words]);
    match words {
        32 => run(backend, OfLength::<3, 32>(planes.map(|plane| plane.as_chunks().0[0])), rows, distances),
        64 => run(backend, OfLength::<3, 64>(planes.map(|plane| plane.as_chunks().0[0])), rows, distances),
        _ => run(backend, OfAnyLength(planes), rows, distances),
    }
}

/// A loop over rows that is compiled once per instruction set.
trait Loop {
    fn run(self, rows: &[u64], distances: &mut [u32]);
}

/// Planes of a length known at compile time.
struct OfLength<const PLANES: usize, const WORDS: usize>([[u64; WORDS]; PLANES]);

impl<const PLANES: usize, const WORDS: usize> Loop for OfLength<PLANES, WORDS> {
    #[inline(always)]
    fn run(self, rows: &[u64], distances: &mut [u32]) {
        for (row, distance) in rows.as_chunks::<WORDS>().0.iter().zip(distances) {
            let mut sum = 0;
            for word in 0..WORDS {
                for (bit, plane) in self.0.iter().enumerate() {
                    sum += u64::from((plane[word] ^ row[word]).count_ones()) << bit;
                }
            }
            *distance = sum as u32;
        }
    }
}

/// Planes of any length, at least one word.
struct OfAnyLength<'a, const PLANES: usize>([&'a [u64]; PLANES]);

impl<const PLANES: usize> Loop for OfAnyLength<'_, PLANES> {
    #[inline(always)]
    fn run(self, rows: &[u64], distances: &mut [u32]) {
        for (row, distance) in rows.chunks_exact(self.0[0].len()).zip(distances) {
            let of_plane = |(bit, plane): (usize, &&[u64])| {
                let differing: u32 = plane.iter().zip(row).map(|(a, b)| (a ^ b).count_ones()).sum();
                differing << bit
            };
            *distance = self.0.iter().enumerate().map(of_plane).sum();
        }
    }
}

fn run(backend: Backend, body: impl Loop, rows: &[u64], distances: &mut [u32]) {
    match backend.kind() {
        Kind::Portable => body.run(rows, distances),
        // SAFETY: the backend's value proves that the CPU has AVX2; POPCNT is part of the detection of the backend.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { run_popcnt(body, rows, distances) },
        // SAFETY: as above for AVX-512; vectorized bit counts have just been detected.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni if is_x86_feature_detected!("avx512vpopcntdq") => unsafe {
            run_vpopcntdq(body, rows, distances);
        },
        // SAFETY: a CPU with AVX-512 has AVX2 and POPCNT, which are part of its detection.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { run_popcnt(body, rows, distances) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt")]
fn run_popcnt(body: impl Loop, rows: &[u64], distances: &mut [u32]) {
    body.run(rows, distances);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512vl,avx512vpopcntdq")]
fn run_vpopcntdq(body: impl Loop, rows: &[u64], distances: &mut [u32]) {
    body.run(rows, distances);
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

    #[test]
    fn known_distances_of_three_bits() {
        // Numbers 5, 0 and 7, and 61 zeros.
        let planes = [0b101, 0b100, 0b101];
        let mut distances = [9; 3];
        hamming_of_three_bits(&planes, 1, &[0, 0b111], &mut distances);
        assert_eq!(distances, [12, 2 + 7, 9]);
        hamming_of_three_bits(&[], 0, &[1], &mut distances);
        assert_eq!(distances, [12, 9, 9]);
    }

    fn bit(words: &[u64], b: usize) -> u32 {
        (words[b / 64] >> (b % 64) & 1) as u32
    }

    proptest! {
        #[test]
        fn every_backend_counts_bits(
            words in prop_oneof![1_usize..12, Just(32), Just(64), Just(65)],
            rows in 0_usize..9,
            seed in any::<u64>(),
        ) {
            let number = |i: usize| (i as u64 + 1).wrapping_mul(seed | 1).rotate_left(i as u32 * 7);
            let planes: Vec<u64> = (0..3 * words).map(number).collect();
            let all: Vec<u64> = (1000..1000 + words * rows).map(number).collect();
            let of_rows = |distance: &dyn Fn(&[u64], usize) -> u32| -> Vec<u32> {
                let whole = |row: &[u64]| (0..words * 64).map(|b| distance(row, b)).sum();
                all.chunks_exact(words).map(whole).collect()
            };
            let differing = of_rows(&|row, b| u32::from(bit(row, b) != bit(&planes, b)));
            let apart = of_rows(&|row, b| {
                let number = (0..3).map(|plane| bit(&planes[plane * words..], b) << plane).sum::<u32>();
                number.abs_diff(7 * bit(row, b))
            });
            for backend in Backend::available() {
                let mut distances = vec![0; rows];
                hamming_on(backend, &planes[..words], &all, &mut distances);
                prop_assert_eq!(&distances, &differing, "{}", backend.name());
                three_bits_on(backend, &planes, words, &all, &mut distances);
                prop_assert_eq!(&distances, &apart, "{}", backend.name());
            }
        }
    }
}
