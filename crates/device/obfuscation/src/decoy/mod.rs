//! Decoys: features that fill a query up to the smallest size class (rule L5).
//!
//! A decoy's position is drawn around the positions of real keypoints. Its descriptor is computed only from descriptors
//! of real rows that are sent: not from other descriptors of the image, and not from anything in a profile, which an
//! attacker could choose so that decoys stand out ([`blend`]).
//!
//! `docs/reference/privacy-rules.md` reports how well decoys hide; `tests/decoys` measures it.

mod blend;

use rand::Rng;
use veiloc_descriptor::Descriptors;
use veiloc_geometry::Pixel;

use crate::SealError;
use crate::positions::DistinctPositions;

/// Spread of a decoy about the keypoint it is drawn from, as a part of the image's longer side.
const SPREAD: f64 = 0.05;

/// Appends `count` decoys to the positions of `real` keypoints.
///
/// Decoys share positions as often as real keypoints do; otherwise they lie around a real one, where `allowed`.
pub(crate) fn add_positions<R: Rng + ?Sized>(
    positions: &mut DistinctPositions,
    real: usize,
    count: usize,
    size: [u32; 2],
    allowed: impl Fn(Pixel) -> bool,
    rng: &mut R,
) {
    let distinct = positions.pixels.len();
    let shared = 1.0 - distinct as f64 / real as f64;
    let spread = SPREAD * f64::from(size[0].max(size[1]));
    for decoy in 0..count {
        if decoy > 0 && rng.random::<f64>() < shared {
            positions.index.push(positions.pixels.len() - 1);
            continue;
        }
        let position = positions.index[rng.random_range(0..real)];
        let around = positions.pixels[position];
        let invented = (0..100)
            .map(|_| Pixel::new(around.u + spread * normal(rng), around.v + spread * normal(rng)))
            .find(|p| allowed(*p));
        match invented {
            Some(pixel) => {
                positions.index.push(positions.pixels.len());
                positions.pixels.push(pixel);
            }
            // Hardly any surrounding position is allowed: share the position, because a second one there would identify
            // the decoy.
            None => positions.index.push(position),
        }
    }
}

/// Appends `count` decoys made of the rows in `sent`, which are the real ones.
pub(crate) fn add_descriptors<R: Rng + ?Sized>(
    sent: &mut Descriptors,
    count: usize,
    rng: &mut R,
) -> Result<(), SealError> {
    if count == 0 {
        return Ok(());
    }
    let kind = sent.kind();
    if !kind.can_be_blended() || sent.len() < blend::MIN_ROWS {
        return Err(SealError::NoDecoys { kind: kind.name().to_owned(), keypoints: sent.len() });
    }
    let rows = blend::decoys(sent, count, rng);
    for row in rows {
        sent.push(&row).expect("a decoy has as many numbers as the rows it was made from");
    }
    Ok(())
}

/// A standard normal number (Box and Muller).
fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
