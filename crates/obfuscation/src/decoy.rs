//! Decoys: features that fill a query up to the smallest size class (rule L5).
//!
//! Its position is drawn around the positions of real keypoints. Its descriptor is made of descriptors of real rows that
//! are sent, and of nothing else of the image. RootSIFT: quarters of several descriptors, mirrored (a mirrored patch has
//! a valid descriptor), chosen so that they continue each other, with noise, and with the length and the largest number
//! of real ones. Other kinds: most numbers from one descriptor, the others from two more, with noise, and with the length of the
//! first. Single statistics do not tell decoys from real rows; a classifier trained on decoys, or a search for the pieces
//! among the rows, does better than chance. `docs/privacy.md` has the figures, `tests/decoys.rs` measures them.

use rand::Rng;
use rand::seq::index::sample;
use veiloc_descriptor::{DecoyRecipe, DescriptorKind, Descriptors, Encoding};
use veiloc_geometry::Pixel;

use crate::SealError;
use crate::lift::Places;

/// Spread of a decoy about the keypoint it is drawn from, as a part of the image's longer side.
const SPREAD: f64 = 0.05;
/// How many parents are looked at for each further quarter. More make the seams too good to be true, and the pieces
/// easier to find.
const CANDIDATES: usize = 6;
/// Relative noise of each number of a decoy's descriptor.
const NOISE: f64 = 0.15;
/// Rounds of cutting and scaling a decoy's descriptor.
const CUTS: usize = 6;
/// Rows that one decoy of a kind without a recipe of its own is mixed of.
const PARENTS: usize = 3;
/// Part of the numbers that the first of them gives: with fewer a decoy is farther from all rows than real ones are.
const FIRST: f64 = 0.65;
const ROOT_SIFT_DIM: usize = DescriptorKind::ROOT_SIFT.dim();

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

/// Appends `count` decoys made of the rows that are there, which are the real ones that are sent.
pub(crate) fn add_descriptors<R: Rng + ?Sized>(
    sent: &mut Descriptors,
    count: usize,
    rng: &mut R,
) -> Result<(), SealError> {
    if count == 0 {
        return Ok(());
    }
    let real = sent.clone();
    let kind = real.kind();
    let recipe = kind.decoy_recipe().filter(|recipe| match recipe {
        DecoyRecipe::RootSiftQuarters => true,
        DecoyRecipe::Mixture => real.len() >= PARENTS, // fewer would come near to a copy
    });
    let recipe =
        recipe.ok_or_else(|| SealError::NoDecoys { kind: kind.name().to_owned(), keypoints: real.len() })?;
    for _ in 0..count {
        let row = match recipe {
            DecoyRecipe::RootSiftQuarters => root_sift(&real, rng),
            DecoyRecipe::Mixture => mixture(&real, rng),
        };
        sent.push(&row).expect("a decoy has as many numbers as the rows it was made from");
    }
    Ok(())
}

/// Each number from one of a few different rows, drawn anew for each number and most often the first, so that every number
/// alone is distributed as in real rows; noise; then the length of the first.
fn mixture<R: Rng + ?Sized>(real: &Descriptors, rng: &mut R) -> Vec<u8> {
    let (kind, rows) = (real.kind(), real.view());
    let chosen = sample(rng, real.len(), PARENTS).into_vec();
    let parents: Vec<Vec<i16>> = chosen.iter().map(|&row| rows.values(row).collect()).collect();
    let length = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let wanted = length(&mut parents[0].iter().copied().map(f64::from));
    let spread = NOISE * wanted / (kind.dim() as f64).sqrt();
    let mut values: Vec<f64> = (0..kind.dim())
        .map(|i| {
            let parent = if rng.random::<f64>() < FIRST { 0 } else { rng.random_range(1..PARENTS) };
            f64::from(parents[parent][i]) + spread * normal(rng)
        })
        .collect();
    if kind.encoding() == Encoding::Unsigned {
        for value in &mut values {
            *value = value.max(0.0);
        }
    }
    let scale = wanted / length(&mut values.iter().copied()).max(1e-9);
    values.into_iter().map(|v| kind.encoding().byte(v * scale)).collect()
}

/// 4 × 4 cells of 8 directions: index `(y · 4 + x) · 8 + direction`, direction 0 the dominant one.
///
/// One quarter of the patch after the other is taken from a parent, mirrored about the dominant direction; of a few
/// parents drawn at random the one that continues best what is there already.
fn root_sift<R: Rng + ?Sized>(pool: &Descriptors, rng: &mut R) -> Vec<u8> {
    let mut values = [0.0; ROOT_SIFT_DIM];
    let full_length = f64::from(DescriptorKind::ROOT_SIFT.norm());
    let mut largest = 0.0;
    for quarter in 0..4 {
        let candidates = if quarter == 0 { 1 } else { CANDIDATES };
        let parent = (0..candidates)
            .map(|_| pool.row(rng.random_range(0..pool.len())))
            .map(|parent| (seam(&values, parent, quarter), parent))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(pool.row(0), |(_, parent)| parent);
        largest += parent.iter().copied().max().map_or(0.0, f64::from) / 4.0;
        for (y, x) in cells(quarter) {
            for direction in 0..8 {
                values[(y * 4 + x) * 8 + direction] = mirrored(parent, y, x, direction);
            }
        }
    }
    for value in &mut values {
        *value *= (1.0 + NOISE * normal(rng)).max(0.0);
    }
    // SIFT cuts large numbers off, so none may stand out; the length is what all RootSIFT vectors have.
    for _ in 0..CUTS {
        let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
        for value in &mut values {
            *value = (*value / norm * full_length).min(largest);
        }
    }
    values.iter().map(|v| v.round().min(255.0) as u8).collect()
}

/// The four cells of a quarter, `(y, x)`.
fn cells(quarter: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..4).map(move |i| (quarter / 2 * 2 + i / 2, quarter % 2 * 2 + i % 2))
}

/// A number of the descriptor of the mirrored patch.
fn mirrored(row: &[u8], y: usize, x: usize, direction: usize) -> f64 {
    f64::from(row[((3 - y) * 4 + x) * 8 + (8 - direction) % 8])
}

/// How much a quarter taken from `parent` differs from its neighbours above and to the left, which are there.
fn seam(values: &[f64; ROOT_SIFT_DIM], parent: &[u8], quarter: usize) -> f64 {
    let mut sum = 0.0;
    for (y, x) in cells(quarter) {
        for direction in 0..8 {
            let mine = mirrored(parent, y, x, direction);
            if y == 2 {
                sum += (mine - values[(4 + x) * 8 + direction]).powi(2);
            }
            if x == 2 {
                sum += (mine - values[(y * 4 + 1) * 8 + direction]).powi(2);
            }
        }
    }
    sum
}

/// A standard normal number (Box and Muller).
fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
