//! A global descriptor in an eighth of its bytes: the signs of its codes after a fixed rotation.
//!
//! The rotation mixes all codes, so that each rotated code is a sum of many and its sign is one bit of the direction.
//! The error of the angle between a vector and one reduced to signs is about `1 / √n` for `n` codes (Gao and Long,
//! *RaBitQ*, SIGMOD 2024, with its Theorem 3.2). Unlike a basis learned from the images of a map, the rotation needs no
//! storage and does not change when images are added.
//!
//! The rotation: a fixed pseudorandom permutation and fixed pseudorandom signs, then a Hadamard transform of each block
//! of a power of two; all in integers, equal on every machine.

use veiloc_simd::hadamard;

use crate::GlobalDescriptor;

impl GlobalDescriptor {
    /// Number of bytes of the signs of `codes` codes.
    pub const fn signs_len(codes: usize) -> usize {
        codes.div_ceil(8)
    }

    /// The signs of its rotated codes, `[signs_len]`; the first is the lowest bit of the first byte.
    pub fn to_signs(&self) -> Vec<u8> {
        Mixing::new(self.len()).signs(self.as_codes()).collect()
    }

    /// The descriptor of `codes` codes that has these signs; its angles to others are approximations. `None` when the
    /// length of `signs` does not match `codes`.
    pub fn from_signs(signs: &[u8], codes: usize) -> Option<Self> {
        let beyond =
            (!codes.is_multiple_of(8)).then(|| signs.last().map(|last| last >> (codes % 8))).flatten();
        if signs.len() != Self::signs_len(codes) || beyond.unwrap_or(0) != 0 {
            return None;
        }
        let mut values: Vec<i32> =
            (0..codes).map(|i| if signs[i / 8] >> (i % 8) & 1 == 1 { 1 } else { -1 }).collect();
        hadamard_blocks(&mut values);
        let mixing = Mixing::new(codes);
        let mut own = vec![0; codes];
        for (block, values) in blocks(codes).zip(block_values(&values)) {
            // The spread of sums of this many signs.
            let scale = SPREAD / (values.len() as f64).sqrt();
            for ((to, sign), value) in mixing.order[block].iter().zip(values) {
                let code = f64::from(value * sign) * scale;
                own[*to] = code.round().clamp(-127.0, 127.0) as i8;
            }
        }
        Some(Self::new(own))
    }
}

/// Root mean square of the codes restored from signs: the rounding error is small, and codes up to four times as large
/// fit.
const SPREAD: f64 = 31.0;

/// The permutation and the signs.
#[derive(Clone)]
pub(crate) struct Mixing {
    order: Vec<(usize, i32)>,
}

impl Mixing {
    /// For descriptors of `codes` codes.
    pub(crate) fn new(codes: usize) -> Self {
        let mut state = 0x7665_696c_6f63_0001_u64;
        let mut order: Vec<(usize, i32)> =
            (0..codes).map(|i| (i, if next(&mut state) & 1 == 1 { 1 } else { -1 })).collect();
        for i in (1..codes).rev() {
            order.swap(i, (next(&mut state) % (i as u64 + 1)) as usize);
        }
        Self { order }
    }

    /// The rotated codes of a descriptor with the same number of codes; those of a block of `n` are `√n` times as long.
    pub(crate) fn rotated(&self, codes: &[i8]) -> Vec<i32> {
        let mut rotated: Vec<i32> =
            self.order.iter().map(|(from, sign)| i32::from(codes[*from]) * sign).collect();
        hadamard_blocks(&mut rotated);
        rotated
    }

    /// The signs of a descriptor with the same number of codes, eight per byte.
    pub(crate) fn signs(&self, codes: &[i8]) -> impl Iterator<Item = u8> + use<> {
        let bytes: Vec<u8> = self.rotated(codes).iter().map(|value| u8::from(*value >= 0)).collect();
        let count = bytes.len().div_ceil(8);
        (0..count).map(move |byte| {
            let own = &bytes[8 * byte..bytes.len().min(8 * byte + 8)];
            let mut eight = [0; 8];
            eight[..own.len()].copy_from_slice(own);
            // The lowest bit of each byte, gathered in the highest byte.
            (u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
        })
    }
}

/// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): fixed numbers, not randomness.
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// `len` as a sum of powers of two, largest first, as ranges.
pub(crate) fn blocks(len: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    let mut start = 0;
    std::iter::from_fn(move || {
        let size = 1 << (len - start).checked_ilog2()?;
        start += size;
        Some(start - size..start)
    })
}

fn block_values(values: &[i32]) -> impl Iterator<Item = &[i32]> {
    blocks(values.len()).map(|block| &values[block])
}

/// The Hadamard transform of each block.
fn hadamard_blocks(values: &mut [i32]) {
    for block in blocks(values.len()) {
        hadamard(&mut values[block]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(codes: usize, seed: u64) -> GlobalDescriptor {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        GlobalDescriptor::new((0..codes).map(|_| rng.random_range(-40..=40)).collect())
    }

    /// A vector at this angle to `a`.
    fn at_cosine(a: &GlobalDescriptor, cosine: f64, seed: u64) -> GlobalDescriptor {
        let other = random(a.len(), seed);
        let sine = (1.0 - cosine * cosine).sqrt();
        let mix = |(a, b): (&i8, &i8)| (cosine * f64::from(*a) + sine * f64::from(*b)).round() as i8;
        GlobalDescriptor::new(a.as_codes().iter().zip(other.as_codes()).map(mix).collect())
    }

    #[test]
    fn angles_are_preserved() {
        let a = random(4096, 1);
        for cosine in [0.0, 0.1, 0.3, 0.6, 0.9] {
            let b = at_cosine(&a, cosine, 2);
            let restored = GlobalDescriptor::from_signs(&b.to_signs(), 4096).expect("as many");
            let before = a.similarity(b.as_codes());
            // Signs keep √(2/π) of a vector's length in its own direction, for any vector.
            let after = a.similarity(restored.as_codes()) / std::f32::consts::FRAC_2_PI.sqrt();
            assert!((before - after).abs() < 3.0 / 64.0, "{cosine}: {before} {after}");
        }
    }

    #[test]
    fn rotation_spreads_a_single_large_code() {
        let mut codes = vec![0; 1024];
        codes[77] = 127;
        let lone = GlobalDescriptor::new(codes);
        let restored = GlobalDescriptor::from_signs(&lone.to_signs(), 1024).expect("as many");
        assert!(lone.similarity(restored.as_codes()) > 0.95);
    }

    #[test]
    fn blocks_are_powers_of_two() {
        let sizes = |len| blocks(len).map(|b| b.len()).collect::<Vec<_>>();
        assert_eq!(sizes(1088), [1024, 64]);
        assert_eq!(sizes(7), [4, 2, 1]);
        assert_eq!(sizes(0), [0; 0]);
    }

    #[test]
    fn signs_of_other_lengths_are_rejected() {
        assert_eq!(GlobalDescriptor::from_signs(&[0; 2], 8), None);
        assert_eq!(GlobalDescriptor::from_signs(&[0x10], 4), None, "bits beyond the codes");
        assert!(GlobalDescriptor::from_signs(&[0x0f], 4).is_some());
        assert_eq!(GlobalDescriptor::from_signs(&[], 0), Some(GlobalDescriptor::new(Vec::new())));
    }

    proptest! {
        #[test]
        fn restored_descriptor_has_the_same_signs(codes in 1_usize..700, seed in any::<u64>()) {
            let signs = random(codes, seed).to_signs();
            let restored = GlobalDescriptor::from_signs(&signs, codes).expect("as many");
            prop_assert_eq!(restored.to_signs(), signs);
        }
    }
}
