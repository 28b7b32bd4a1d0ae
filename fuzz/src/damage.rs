//! Mutated copies of valid inputs, the same in every run.

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

/// Checks `property` on the files of a folder, which all have the given extension, and on `count` mutated copies of
/// them (the environment variable `VEILOC_DAMAGED` sets another count).
///
/// # Panics
/// When the folder has no file or a file with another extension, and when the property panics.
pub fn check_files(folder: &std::path::Path, extension: &str, count: usize, property: impl Fn(&[u8])) {
    let mut paths: Vec<_> =
        std::fs::read_dir(folder).expect("seeds").map(|entry| entry.expect("an entry").path()).collect();
    paths.sort();
    let seeds: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).expect("a seed")).collect();
    assert!(!seeds.is_empty() && paths.iter().all(|path| path.extension().is_some_and(|e| e == extension)));
    let count = std::env::var("VEILOC_DAMAGED").ok().and_then(|n| n.parse().ok()).unwrap_or(count);
    let mut numbers = SplitMix64(1);
    for seed in &seeds {
        property(seed);
    }
    for _ in 0..count {
        let (one, other) = (numbers.below(seeds.len()), numbers.below(seeds.len()));
        property(&numbers.mutated(&seeds[one], &seeds[other]));
    }
}
