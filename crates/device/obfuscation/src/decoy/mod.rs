//! Decoys: features that fill a query up to the smallest size class (rule L5).
//!
//! Its position is drawn around the positions of real keypoints. Its descriptor is made of descriptors of real rows that
//! are sent, and of nothing else: neither of others of the image, nor of anything that a profile says, which somebody could choose
//! so that decoys stand out ([`blend`]).
//!
//! `docs/reference/privacy-rules.md` has the figures of how well they hide, `tests/decoys` measures them.

mod blend;

use rand::Rng;
use veiloc_descriptor::Descriptors;
use veiloc_geometry::Pixel;

use crate::SealError;
use crate::places::Places;

/// Spread of a decoy about the keypoint it is drawn from, as a part of the image's longer side.
const SPREAD: f64 = 0.05;

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
    let kind = sent.kind();
    if !kind.can_be_blended() || sent.len() < blend::FEWEST {
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
