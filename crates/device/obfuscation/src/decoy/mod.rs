//! Decoys: features that fill a query up to the smallest size class (rule L5).
//!
//! Decoys are copies of all real rows that are sent, with descriptors that are rotated ([`blend`]) and positions near
//! those of the rows: what holds between the descriptors and positions of two real rows holds between their copies.
//! Nothing else enters: no other descriptors of the image, and nothing of a profile, which an attacker could choose so
//! that decoys stand out.
//!
//! `docs/reference/privacy-rules.md` reports how well decoys hide; `tests/decoys` measures it.

mod blend;

use std::collections::BTreeMap;

use rand::Rng;
use veiloc_descriptor::Descriptors;
use veiloc_geometry::Pixel;

use crate::SealError;
use crate::positions::DistinctPositions;

/// Spread of the decoys about the keypoint that they are copies of, as a part of the image's longer side, when there is
/// one for each keypoint; it grows with the square root of their number.
const SPREAD: f64 = 0.015;

/// Appends `count` decoys to the positions and the descriptors of the rows that are sent, `[N]` real ones each.
///
/// A decoy lies near the keypoint that it is a copy of, where `allowed`. Decoys share positions as their keypoints do.
pub(crate) fn add<R: Rng + ?Sized>(
    positions: &mut DistinctPositions,
    sent: &mut Descriptors,
    count: usize,
    size: [u32; 2],
    allowed: impl Fn(Pixel) -> bool,
    rng: &mut R,
) -> Result<(), SealError> {
    if count == 0 {
        return Ok(());
    }
    let (kind, real) = (sent.kind(), sent.len());
    if !kind.can_be_blended() || real < blend::MIN_ROWS {
        return Err(SealError::NoDecoys { kind: kind.name().to_owned(), keypoints: real });
    }
    let decoys = blend::decoys(sent, &positions.index, count, rng);
    let spread = spread(size, count, real);
    let mut copied = BTreeMap::new();
    for decoy in decoys {
        let original = positions.index[decoy.origin];
        let position = *copied
            .entry((decoy.copy, original))
            .or_insert_with(|| invented(positions, original, spread, &allowed, rng));
        positions.index.push(position);
        sent.push(&decoy.row).expect("a decoy has as many numbers as the rows it was made from");
    }
    Ok(())
}

/// Appends `count` positions as those of decoys, each about a random row.
pub(crate) fn scatter<R: Rng + ?Sized>(
    positions: &mut DistinctPositions,
    count: usize,
    size: [u32; 2],
    allowed: impl Fn(Pixel) -> bool,
    rng: &mut R,
) {
    let real = positions.index.len();
    let spread = spread(size, count, real);
    for _ in 0..count {
        let original = positions.index[rng.random_range(0..real)];
        let position = invented(positions, original, spread, &allowed, rng);
        positions.index.push(position);
    }
}

/// Standard deviation of `count` decoys about `real` rows, pixels.
fn spread(size: [u32; 2], count: usize, real: usize) -> f64 {
    SPREAD * f64::from(size[0].max(size[1])) * (count as f64 / real as f64).sqrt()
}

/// A new position near another one, as an index.
fn invented<R: Rng + ?Sized>(
    positions: &mut DistinctPositions,
    original: usize,
    spread: f64,
    allowed: &impl Fn(Pixel) -> bool,
    rng: &mut R,
) -> usize {
    let around = positions.pixels[original];
    let found = (0..100)
        .map(|_| Pixel::new(around.u + spread * normal(rng), around.v + spread * normal(rng)))
        .find(|p| allowed(*p));
    match found {
        Some(pixel) => {
            positions.pixels.push(pixel);
            positions.pixels.len() - 1
        }
        // Hardly any surrounding position is allowed: share the position, because a second one there would
        // identify the decoy.
        None => original,
    }
}

/// A standard normal number (Box and Muller).
fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
