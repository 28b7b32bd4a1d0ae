//! Decoys: features that fill a query up to the smallest size class, and that nothing marks (rule L5).
//!
//! What a decoy imitates, and how well, is told in `docs/privacy.md`. In short: its position is drawn around the
//! positions of real keypoints; its descriptor is put together from quarters of several real descriptors of the same
//! picture, mirrored (a mirrored patch has a valid descriptor), with noise, at the length all RootSIFT vectors have.
//! Someone who looks for these halves and quarters among the rows can tell decoys from real rows better than chance.

use rand::Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::Pixel;

use crate::lift::Places;

/// Spread of a decoy about the keypoint it is drawn from, as a part of the picture's longer side.
const SPREAD: f64 = 0.05;
/// How many descriptors are looked at to find a parent that resembles the first.
const CANDIDATES: usize = 12;
/// Relative noise of each number of a decoy's descriptor.
const NOISE: f64 = 0.15;
/// Length of a RootSIFT vector in code units.
const ROOT_SIFT_NORM: f64 = 512.0;

/// Appends `count` decoys to the places of `real` keypoints.
///
/// As often as real keypoints share a place, decoys do; else they lie around a real one, where `allowed`.
pub(crate) fn add_places<R: Rng + ?Sized>(
    places: &mut Places,
    real: usize,
    count: usize,
    size: [u32; 2],
    allowed: impl Fn(Pixel) -> bool,
    rng: &mut R,
) {
    let distinct = places.pixels.len();
    let shared = 1.0 - distinct as f64 / real as f64;
    let spread = SPREAD * f64::from(size[0].max(size[1]));
    for decoy in 0..count {
        if decoy > 0 && rng.random::<f64>() < shared {
            places.of.push(places.pixels.len() - 1);
            continue;
        }
        let place = places.of[rng.random_range(0..real)];
        let around = places.pixels[place];
        let invented = (0..100)
            .map(|_| Pixel::new(around.u + spread * normal(rng), around.v + spread * normal(rng)))
            .find(|p| allowed(*p));
        match invented {
            Some(pixel) => {
                places.of.push(places.pixels.len());
                places.pixels.push(pixel);
            }
            // Hardly any surroundings are allowed: share the place, for a second one there would betray it.
            None => places.of.push(place),
        }
    }
}

/// Appends `count` decoys made from the descriptors of the whole picture, sent or not.
pub(crate) fn add_descriptors<R: Rng + ?Sized>(
    sent: &mut Descriptors,
    pool: &Descriptors,
    count: usize,
    rng: &mut R,
) {
    for _ in 0..count {
        let row = match pool.kind() {
            DescriptorKind::RootSift => root_sift(pool, rng),
            // A kind without a recipe is resampled: its decoys are copies.
            _ => pool.row(rng.random_range(0..pool.len())).to_vec(),
        };
        sent.push(&row).expect("a decoy has as many numbers as the rows it was made from");
    }
}

/// 4 × 4 cells of 8 directions: index `(y · 4 + x) · 8 + direction`, direction 0 the dominant one.
fn root_sift<R: Rng + ?Sized>(pool: &Descriptors, rng: &mut R) -> Vec<u8> {
    let first = rng.random_range(0..pool.len());
    // One parent for each quarter of the patch: the first, and three that resemble it.
    let parents: [usize; 4] = std::array::from_fn(|i| if i == 0 { first } else { similar(pool, first, rng) });
    let turn = rng.random_range(0..4);
    let mut values = [0.0; 128];
    for y in 0..4 {
        for x in 0..4 {
            let parent = pool.row(parents[(y / 2 * 2 + x / 2 + turn) % 4]);
            for direction in 0..8 {
                // Mirrored about the dominant direction.
                let from = ((3 - y) * 4 + x) * 8 + (8 - direction) % 8;
                let noise = 1.0 + NOISE * normal(rng);
                values[(y * 4 + x) * 8 + direction] = f64::from(parent[from]) * noise.max(0.0);
            }
        }
    }
    let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
    values.iter().map(|v| (v / norm * ROOT_SIFT_NORM).round().min(255.0) as u8).collect()
}

/// Of a few descriptors drawn at random, the nearest to one that is not that one itself.
fn similar<R: Rng + ?Sized>(pool: &Descriptors, to: usize, rng: &mut R) -> usize {
    let distance = |i: usize| -> u32 {
        let squared = |(a, b): (&u8, &u8)| u32::from(a.abs_diff(*b)).pow(2);
        pool.row(i).iter().zip(pool.row(to)).map(squared).sum()
    };
    (0..CANDIDATES)
        .map(|_| rng.random_range(0..pool.len()))
        .filter(|&i| i != to)
        .min_by_key(|&i| (distance(i), i))
        .unwrap_or(to)
}

/// A standard normal number (Box and Muller).
fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
