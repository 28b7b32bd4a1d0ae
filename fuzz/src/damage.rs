//! Mutated copies of valid inputs, the same in every run.

use std::fs;
use std::path::{Path, PathBuf};

/// A deterministic random generator (splitmix64).
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    /// A number below `bound`, or 0.
    pub fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % bound.max(1) as u64) as usize
    }

    /// One to four mutations: a changed byte, a flipped bit, a truncation, a repeated part, a boundary value, a splice.
    pub fn mutated(&mut self, seed: &[u8], other: &[u8]) -> Vec<u8> {
        let mut bytes = seed.to_vec();
        for _ in 0..=self.below(4) {
            let at = self.below(bytes.len());
            match self.below(6) {
                0 if at < bytes.len() => bytes[at] = self.below(256) as u8,
                1 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                2 => bytes.truncate(at),
                3 => {
                    let part = bytes[at..(at + self.below(64)).min(bytes.len())].to_vec();
                    bytes.splice(at..at, part);
                }
                4 if at + 8 <= bytes.len() => {
                    let edge = [0, 1, u64::MAX, u64::from(u32::MAX), 1 << 31, 1 << 63][self.below(6)];
                    bytes[at..at + 8].copy_from_slice(&edge.to_le_bytes());
                }
                _ => {
                    let from = self.below(other.len());
                    bytes.truncate(at);
                    bytes.extend(&other[from..]);
                }
            }
        }
        bytes
    }
}

/// The files in a folder whose names have this ending, in order.
///
/// # Panics
/// When there is none.
pub fn files(folder: &Path, ending: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    paths.retain(|path| path.to_str().is_some_and(|path| path.ends_with(ending)));
    paths.sort();
    assert!(!paths.is_empty(), "no file *{ending} in {}", folder.display());
    paths.iter().map(|path| fs::read(path).expect("a file")).collect()
}

/// Checks a property on seeds and on `count` mutated copies of them (the environment variable `VEILOC_DAMAGED` sets
/// another count). The property panics when it does not hold, and says whether the input was accepted.
///
/// # Panics
/// When the property panics, a seed is refused, or all mutated copies are accepted or all refused: then it tests
/// nothing.
pub fn check(seeds: &[Vec<u8>], count: usize, property: impl Fn(&[u8]) -> bool) {
    for (index, seed) in seeds.iter().enumerate() {
        assert!(property(seed), "seed {index} is refused");
    }
    let count = std::env::var("VEILOC_DAMAGED").ok().and_then(|n| n.parse().ok()).unwrap_or(count);
    let mut numbers = SplitMix64(1);
    let mut accepted = 0;
    for _ in 0..count {
        let (one, other) = (numbers.below(seeds.len()), numbers.below(seeds.len()));
        accepted += usize::from(property(&numbers.mutated(&seeds[one], &seeds[other])));
    }
    assert!(0 < accepted && accepted < count, "{accepted} of {count} mutated copies are accepted");
}
