//! An occluder covers one half of the image in flat gray: cut through the centre in any direction, or the left or
//! right half.
//!
//! It is flat so that the loss of content is the only difference; a textured occluder would cause wrong matches too.

use std::f64::consts::{PI, TAU};

use rand::Rng;
use veiloc_features::GrayImage;

use super::with_samples;

/// Stored sample value of the occluder.
const GRAY: f32 = 0.5;

/// The image with one half covered; the cut passes through the centre in a random direction.
pub(super) fn half_hidden(image: &GrayImage, rng: &mut impl Rng) -> GrayImage {
    hidden(image, rng.random_range(0.0..TAU))
}

/// The image with its left or right half covered at random. For an odd number of columns the middle one stays
/// visible.
pub(super) fn side_hidden(image: &GrayImage, rng: &mut impl Rng) -> GrayImage {
    hidden(image, if rng.random() { PI } else { 0.0 })
}

/// Covers the half towards `angle` (radians, 0 to the right, a quarter turn down) from the centre.
fn hidden(image: &GrayImage, angle: f64) -> GrayImage {
    let (width, height) = (image.width(), image.height());
    let from_middle = |at: u32, of: u32| f64::from(at) + 0.5 - 0.5 * f64::from(of);
    // Pixels with centres this close to the cut stay visible, in spite of rounding in sine and cosine.
    let covered = |u, v| from_middle(u, width) * angle.cos() + from_middle(v, height) * angle.sin() > 1e-6;
    let positions = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
    let samples = positions.zip(image.data()).map(|((u, v), s)| if covered(u, v) { GRAY } else { *s });
    with_samples(image, samples)
}

#[cfg(test)]
mod tests {
    use super::super::tests::texture;
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn exactly_one_half_is_covered() {
        let image = texture(64, 48);
        for quarter in 0..4 {
            let worse = hidden(&image, 0.5 * PI * f64::from(quarter));
            let changed: Vec<usize> =
                (0..64 * 48).filter(|i| (worse.data()[*i] - image.data()[*i]).abs() > 0.003).collect();
            let gray = worse.data().iter().filter(|v| (**v - GRAY).abs() < 0.003).count();
            assert!((64 * 24..64 * 24 + 64).contains(&gray), "{quarter}: {gray}");
            let inside = changed.iter().all(|i| {
                let (u, v) = (i % 64, i / 64);
                [u >= 32, v >= 24, u < 32, v < 24][quarter as usize]
            });
            assert!(inside && changed.len() > 1400, "{quarter}: {} pixels", changed.len());
        }
        let odd = hidden(&texture(5, 5), PI);
        assert_eq!(odd.data().iter().filter(|v| (**v - GRAY).abs() < 0.003).count(), 10);
    }

    #[test]
    fn cuts_cover_all_directions_and_sides_are_left_or_right() {
        let image = texture(32, 32);
        let drawn = |seed| ChaCha8Rng::seed_from_u64(seed);
        // Covered corners: over all directions each corner is covered sometimes, and at least one is always visible.
        let corners =
            |image: &GrayImage| [0, 31, 32 * 31, 32 * 32 - 1].map(|i| (image.data()[i] - GRAY).abs() < 0.003);
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..60 {
            seen.insert(corners(&half_hidden(&image, &mut drawn(seed))));
            let side = side_hidden(&image, &mut drawn(seed));
            assert!(side == hidden(&image, 0.0) || side == hidden(&image, PI));
        }
        assert!(seen.len() >= 4 && seen.iter().all(|c| c.iter().filter(|c| **c).count() <= 3), "{seen:?}");
        for of in [0.0, PI] {
            assert!((0..40).any(|seed| side_hidden(&image, &mut drawn(seed)) == hidden(&image, of)));
        }
    }
}
