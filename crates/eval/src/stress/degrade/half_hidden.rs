//! Something stands before one half of the image: left, right, top or bottom, flat gray.
//!
//! Flat, so that what is lost is the only difference; a thing with a texture of its own would bring wrong matches too.

use rand::Rng;
use veiloc_features::GrayImage;

use super::with_samples;

/// Stored sample of what stands there.
const GRAY: f32 = 0.5;

/// The image with one half, drawn at random of four, covered. Of an odd number of columns or rows the middle one stays.
pub(super) fn half_hidden(image: &GrayImage, rng: &mut impl Rng) -> GrayImage {
    hidden(image, rng.random_range(0..4))
}

/// `side`: 0 left, 1 right, 2 top, 3 bottom.
fn hidden(image: &GrayImage, side: u32) -> GrayImage {
    let (width, height) = (image.width(), image.height());
    let covered = |u: u32, v: u32| match side {
        0 => u < width / 2,
        1 => u >= width.div_ceil(2),
        2 => v < height / 2,
        _ => v >= height.div_ceil(2),
    };
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
        for side in 0..4 {
            let worse = hidden(&image, side);
            let changed: Vec<usize> =
                (0..64 * 48).filter(|i| (worse.data()[*i] - image.data()[*i]).abs() > 0.003).collect();
            let gray = worse.data().iter().filter(|v| (**v - GRAY).abs() < 0.003).count();
            assert!((64 * 24..64 * 24 + 64).contains(&gray), "{side}: {gray}");
            let inside = changed.iter().all(|i| {
                let (u, v) = (i % 64, i / 64);
                [u < 32, u >= 32, v < 24, v >= 24][side as usize]
            });
            assert!(inside && changed.len() > 1400, "{side}: {} pixels", changed.len());
        }
        let odd = hidden(&texture(5, 5), 0);
        assert_eq!(odd.data().iter().filter(|v| (**v - GRAY).abs() < 0.003).count(), 10);
    }

    #[test]
    fn every_side_is_drawn() {
        let image = texture(8, 8);
        let drawn = |seed| half_hidden(&image, &mut ChaCha8Rng::seed_from_u64(seed));
        for side in 0..4 {
            assert!((0..40).any(|seed| drawn(seed) == hidden(&image, side)), "{side}");
        }
    }
}
