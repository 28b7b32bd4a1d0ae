//! Degradation of images in memory: what a device's camera would have recorded under a [`StressCondition`].
//!
//! The degradation is applied to the gray image of feature extraction, whose samples are treated as sRGB-encoded
//! luminance. The pose of a query stays valid: motion is centred on the middle of the exposure, and no degradation
//! shifts the image. Results are rounded to 8 bits, as a camera stores them.

mod dark;
mod half_hidden;
mod low_resolution;
mod motion;
mod srgb;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::GrayImage;
use veiloc_geometry::Intrinsics;

use super::condition::StressCondition;

/// The image under a stress; `None` if the stress does not change images. Equal seeds and names give equal images.
pub(super) fn degraded(
    image: &GrayImage,
    stress: StressCondition,
    name: &str,
    seed: u64,
) -> Option<GrayImage> {
    let mut rng = rng_of(stress, name, seed);
    match stress {
        StressCondition::None
        | StressCondition::SparseMap
        | StressCondition::FewKeypoints
        | StressCondition::Focal(_) => None,
        StressCondition::Dark => Some(dark::dark(image, &mut rng)),
        StressCondition::Motion => Some(motion::motion_blurred(image, &mut rng)),
        StressCondition::HalfHidden => Some(half_hidden::half_hidden(image, &mut rng)),
        StressCondition::SideHidden => Some(half_hidden::side_hidden(image, &mut rng)),
        StressCondition::LowResolution => Some(low_resolution::low_resolution(image)),
    }
}

/// The camera that a device assumes under a stress; `None` when it is right. Too long and too short are equally
/// likely.
pub(super) fn wrong_camera(
    camera: &Intrinsics,
    stress: StressCondition,
    name: &str,
    seed: u64,
) -> Option<Intrinsics> {
    let StressCondition::Focal(percent) = stress else { return None };
    let factor = 1.0 + f64::from(percent) / 100.0;
    let longer = rng_of(stress, name, seed).random();
    Some(camera.zoomed(if longer { factor } else { factor.recip() }))
}

fn rng_of(stress: StressCondition, name: &str, seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, &stress.to_string()]))
}

/// The same image with other samples, rounded to 8 bits.
fn with_samples(image: &GrayImage, samples: impl Iterator<Item = f32>) -> GrayImage {
    let bytes: Vec<u8> = samples.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    GrayImage::from_luma8(image.width(), image.height(), &bytes).expect("as many samples as before")
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn degradation_depends_on_seed() {
        let image = texture(96, 64);
        for stress in StressCondition::DEFAULT {
            let of = |name: &str, seed| degraded(&image, stress, name, seed);
            assert!(of("a", 1) == of("a", 1), "{stress}");
            let Some(worse) = of("a", 1) else {
                assert!(matches!(
                    stress,
                    StressCondition::None | StressCondition::SparseMap | StressCondition::FewKeypoints
                ));
                continue;
            };
            assert_eq!((worse.width(), worse.height()), (96, 64), "{stress}");
            assert!(worse.data().iter().all(|v| (0.0..=1.0).contains(v)), "{stress}");
            let random = (0..8).any(|seed| of("a", seed) != of("a", 1))
                && ["b", "c", "d", "e", "f", "g", "h", "i"].iter().any(|name| of(name, 1) != of("a", 1));
            // There are only two sides, so nine names or seeds do not all give different images.
            assert_eq!(random, stress != StressCondition::LowResolution, "{stress}");
        }
    }

    #[test]
    fn wrong_focal_length_is_too_long_or_too_short() {
        let camera = Intrinsics::new("OPENCV", 640, 480, &[500.0, 510.0, 320.0, 240.0, 0.1, 0.0, 0.0, 0.0])
            .expect("a camera");
        let factors: Vec<f64> = (0..20)
            .filter_map(|seed| wrong_camera(&camera, StressCondition::Focal(10), "a", seed))
            .map(|wrong| wrong.pinhole().mean_focal() / camera.pinhole().mean_focal())
            .collect();
        let count = |factor: f64| factors.iter().filter(|f| (*f / factor - 1.0).abs() < 1e-12).count();
        assert!(count(1.1) > 4 && count(1.0 / 1.1) > 4 && count(1.1) + count(1.0 / 1.1) == 20, "{factors:?}");
        assert_eq!(wrong_camera(&camera, StressCondition::Dark, "a", 0), None);
    }

    /// One-pixel images are valid input.
    #[test]
    fn one_pixel_images_are_valid() {
        let image = GrayImage::new(1, 1, vec![0.5]).expect("an image");
        for stress in StressCondition::DEFAULT {
            let worse = degraded(&image, stress, "a", 0);
            assert!(worse.is_none_or(|w| w.data().len() == 1), "{stress}");
        }
    }
}
