//! Random descriptors for tests.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{DescriptorKind, Descriptors};

/// `count` rows similar to RootSIFT: squares of the components sum to about 512 squared, a few components are large.
pub(crate) fn random_descriptors(count: usize, seed: u64) -> Descriptors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rows = Descriptors::empty(DescriptorKind::ROOT_SIFT);
    for _ in 0..count {
        rows.push(&rootsift_like(&mut rng)).expect("rows of the kind's length");
    }
    rows
}

/// `count` rows near `centers` random ones, in turn.
pub(crate) fn clustered_descriptors(count: usize, centers: usize, spread: i16, seed: u64) -> Descriptors {
    let middles = random_descriptors(centers, seed);
    let mut rng = ChaCha8Rng::seed_from_u64(!seed);
    let mut rows = Descriptors::empty(DescriptorKind::ROOT_SIFT);
    for i in 0..count {
        let center = middles.row(i % centers);
        let row: Vec<u8> = center
            .iter()
            .map(|&c| (i16::from(c) + rng.random_range(-spread..=spread)).clamp(0, 255) as u8)
            .collect();
        rows.push(&row).expect("rows of the kind's length");
    }
    rows
}

fn rootsift_like(rng: &mut ChaCha8Rng) -> [u8; 128] {
    let histogram: [f32; 128] = std::array::from_fn(|_| rng.random_range(0.0_f32..1.0).powi(3));
    let total: f32 = histogram.iter().sum();
    histogram.map(|h| ((h / total).sqrt() * 512.0).round().min(255.0) as u8)
}

/// `count` rows of random bytes.
pub(crate) fn random_bytes(kind: DescriptorKind, count: usize, seed: u64) -> Descriptors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let bytes = (0..count * kind.dim()).map(|_| rng.random()).collect();
    Descriptors::new(kind, bytes).expect("whole rows")
}
