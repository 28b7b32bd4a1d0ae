//! Images made worse, in memory: what a device's camera would have seen under a [`Stress`].
//!
//! All of it happens to the gray image that extraction sees, whose samples are taken for sRGB-encoded luminance: a
//! camera without colours. The pose of a query stays what it was: motion is centred on the middle of the exposure, and no
//! degradation moves the image. Results are rounded to 8 bits, as a camera writes them.

mod dark;
mod half_hidden;
mod low_resolution;
mod motion;
mod srgb;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::seed_for;
use veiloc_features::GrayImage;

use super::kind::Stress;

/// The image under a stress; `None` for one that does not touch images. Equal seeds and names give equal images.
pub(super) fn degraded(image: &GrayImage, stress: Stress, name: &str, seed: u64) -> Option<GrayImage> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, stress.name()]));
    match stress {
        Stress::None | Stress::SparseMap | Stress::FewKeypoints => None,
        Stress::Dark => Some(dark::dark(image, &mut rng)),
        Stress::Motion => Some(motion::moved(image, &mut rng)),
        Stress::HalfHidden => Some(half_hidden::half_hidden(image, &mut rng)),
        Stress::LowResolution => Some(low_resolution::low_resolution(image)),
    }
}

/// The same image with other samples, rounded to 8 bits.
fn with_samples(image: &GrayImage, samples: impl Iterator<Item = f32>) -> GrayImage {
    let bytes: Vec<u8> = samples.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    GrayImage::from_luma8(image.width(), image.height(), &bytes).expect("as many samples as before")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    /// Random blocks of 4 x 4 pixels.
    pub(super) fn texture(width: u32, height: u32) -> GrayImage {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let blocks: Vec<f32> =
            (0..width.div_ceil(4) * height.div_ceil(4)).map(|_| rng.random_range(0.1..0.9)).collect();
        let at = |x: u32, y: u32| blocks[(y / 4 * width.div_ceil(4) + x / 4) as usize];
        let samples = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| at(x, y));
        GrayImage::new(width, height, samples.collect()).expect("an image")
    }

    #[test]
    fn equal_seeds_give_equal_images_and_others_do_not() {
        let image = texture(96, 64);
        for stress in Stress::ALL {
            let of = |name: &str, seed| degraded(&image, stress, name, seed);
            assert!(of("a", 1) == of("a", 1), "{stress}");
            let Some(worse) = of("a", 1) else {
                assert!(matches!(stress, Stress::None | Stress::SparseMap | Stress::FewKeypoints));
                continue;
            };
            assert_eq!((worse.width(), worse.height()), (96, 64), "{stress}");
            assert!(worse.data().iter().all(|v| (0.0..=1.0).contains(v)), "{stress}");
            let random = (0..8).any(|seed| of("a", seed) != of("a", 1))
                && ["b", "c", "d", "e", "f", "g", "h", "i"].iter().any(|name| of(name, 1) != of("a", 1));
            assert_eq!(random, stress != Stress::LowResolution, "{stress}");
        }
    }

    /// The smallest images are possible input too.
    #[test]
    fn one_pixel_is_enough() {
        let image = GrayImage::new(1, 1, vec![0.5]).expect("an image");
        for stress in Stress::ALL {
            let worse = degraded(&image, stress, "a", 0);
            assert!(worse.is_none_or(|w| w.data().len() == 1), "{stress}");
        }
    }
}
