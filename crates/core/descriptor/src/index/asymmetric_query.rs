//! The query in three bits per code: only signs are stored of images, but more can be kept of the query.
//!
//! Three bits per code leave about half of the error of signs (docs/results/scale.md), for three times the work per word.

use veiloc_simd::{dot_i8, hamming_of_three_bits};

use crate::binary_codes::{Mixing, blocks};

/// The rotated codes of a query in three bits each.
pub(super) struct AsymmetricQuery {
    words: usize,
    /// `[3, words]`, the input of [`hamming_of_three_bits`].
    planes: Vec<u64>,
}

impl AsymmetricQuery {
    /// For a descriptor with as many codes as the rotation.
    pub(super) fn new(mixing: &Mixing, codes: &[i8]) -> Self {
        let rotated = mixing.rotated(codes);
        let words = rotated.len().div_ceil(64);
        let mut planes = vec![0; 3 * words];
        let spread = (dot_i8(codes, codes) as f64 / codes.len().max(1) as f64).sqrt();
        for block in blocks(rotated.len()) {
            let own = &rotated[block.clone()];
            let steps = STEPS / (spread * (own.len() as f64).sqrt()).max(f64::MIN_POSITIVE);
            for (i, value) in block.zip(own) {
                let number = (f64::from(*value) * steps + 4.0).floor().clamp(0.0, 7.0) as u64;
                for (bit, plane) in planes.chunks_exact_mut(words).enumerate() {
                    plane[i / 64] |= (number >> bit & 1) << (i % 64);
                }
            }
        }
        Self { words, planes }
    }

    /// Only some of the words.
    pub(super) fn part(&self, words: std::ops::Range<usize>) -> Self {
        let planes = self.planes.chunks_exact(self.words.max(1)).flat_map(|plane| &plane[words.clone()]);
        Self { planes: planes.copied().collect(), words: words.len() }
    }

    /// Distance of each row of as many words of signs, `[N]`; smaller is more similar.
    pub(super) fn distances(&self, rows: &[u64], distances: &mut [u32]) {
        hamming_of_three_bits(&self.planes, self.words, rows, distances);
    }

    /// The largest possible distance.
    pub(super) const fn largest(&self) -> usize {
        7 * 64 * self.words
    }
}

/// Steps per standard deviation of the codes. For normally distributed codes the outermost three percent have the
/// lowest and the highest step.
const STEPS: f64 = 1.82;
