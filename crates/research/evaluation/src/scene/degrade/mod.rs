//! Degradation of images in memory: what a device's camera would have recorded under a [`Degradation`].
//!
//! The degradation is applied to the gray image of feature extraction, whose samples are treated as sRGB-encoded
//! luminance. The pose of a query stays valid: motion is centred on the middle of the exposure, and no degradation
//! shifts the image. Results are rounded to 8 bits, as a camera stores them.

mod dark;
mod half_hidden;
mod low_resolution;
mod motion;
mod srgb;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::GrayImage;

/// A worse image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Degradation {
    /// An eighth of the light, with photon noise.
    Dark,
    /// The camera moves by 13 px of 640 during the exposure.
    Motion,
    /// Flat gray covers one half of the image, cut through its centre in a random direction.
    HalfHidden,
    /// The same for the left or right half: then all visible keypoints may belong to one anchor of `dcl`.
    SideHidden,
    /// The image is reduced to 160 pixels along its longer side, and enlarged again.
    LowResolution,
}

impl Degradation {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Dark, Self::Motion, Self::HalfHidden, Self::SideHidden, Self::LowResolution];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Motion => "motion",
            Self::HalfHidden => "half-hidden",
            Self::SideHidden => "side-hidden",
            Self::LowResolution => "low-resolution",
        }
    }

    /// The degraded image. Equal seeds and names give equal images.
    pub(super) fn applied(self, image: &GrayImage, name: &str, seed: u64) -> GrayImage {
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[name, self.name()]));
        match self {
            Self::Dark => dark::dark(image, &mut rng),
            Self::Motion => motion::motion_blurred(image, &mut rng),
            Self::HalfHidden => half_hidden::half_hidden(image, &mut rng),
            Self::SideHidden => half_hidden::side_hidden(image, &mut rng),
            Self::LowResolution => low_resolution::low_resolution(image),
        }
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
    fn degradation_depends_on_seed() {
        let image = texture(96, 64);
        for degradation in Degradation::ALL {
            let of = |name: &str, seed| degradation.applied(&image, name, seed);
            let worse = of("a", 1);
            assert!(worse == of("a", 1), "{degradation:?}");
            assert_eq!((worse.width(), worse.height()), (96, 64), "{degradation:?}");
            assert!(worse.data().iter().all(|v| (0.0..=1.0).contains(v)), "{degradation:?}");
            let random = (0..8).any(|seed| of("a", seed) != worse)
                && ["b", "c", "d", "e", "f", "g", "h", "i"].iter().any(|name| of(name, 1) != worse);
            // There are only two sides, so nine names or seeds do not all give different images.
            assert_eq!(random, degradation != Degradation::LowResolution, "{degradation:?}");
        }
    }

    #[test]
    fn one_pixel_images_are_valid() {
        let image = GrayImage::new(1, 1, vec![0.5]).expect("an image");
        for degradation in Degradation::ALL {
            assert_eq!(degradation.applied(&image, "a", 0).data().len(), 1, "{degradation:?}");
        }
    }
}
