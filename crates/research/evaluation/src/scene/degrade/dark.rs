//! Low light: an eighth of the light reaches the sensor; exposure and gain are unchanged.
//!
//! White fills a pixel with [`FULL_WELL`] electrons. Each pixel collects a Poisson number of them, with the mean that
//! its light gives (shot noise), the readout adds [`READ_NOISE`] electrons (normal), and the result is encoded as
//! sRGB again. Middle gray then is 90 electrons with a deviation of 9.9, stored as 41 of 255 with a deviation of 2.7.

use rand::Rng;
use veiloc_features::GrayImage;
use veiloc_synthetic::problems::normal;

use super::srgb::{light_of, stored_of};
use super::with_samples;

/// Remaining share of the light.
const LIGHT: f32 = 1.0 / 8.0;

/// Electrons of a white pixel: a telephone's sensor with pixels of about 1 µm.
const FULL_WELL: f64 = 4000.0;

/// Standard deviation of the readout, electrons.
const READ_NOISE: f64 = 3.0;

/// Means above this are drawn from the normal distribution of the same mean and variance: their skewness is below 0.15.
const MANY: f64 = 50.0;

/// The image in an eighth of the light.
pub(super) fn dark(image: &GrayImage, rng: &mut impl Rng) -> GrayImage {
    let seen = |stored: &f32| {
        let mean = FULL_WELL * f64::from(LIGHT * light_of(stored.clamp(0.0, 1.0)));
        let electrons = poisson(mean, rng) + READ_NOISE * normal(rng);
        stored_of((electrons / FULL_WELL) as f32)
    };
    with_samples(image, image.data().iter().map(seen))
}

/// A Poisson variable: the number of exponential waiting times that fit into `mean` (Knuth), above [`MANY`] its
/// normal approximation.
fn poisson(mean: f64, rng: &mut impl Rng) -> f64 {
    if mean > MANY {
        return (mean + mean.sqrt() * normal(rng)).round().max(0.0);
    }
    let least = (-mean).exp();
    let (mut count, mut product) = (0.0, rng.random::<f64>());
    while product > least {
        count += 1.0;
        product *= rng.random::<f64>();
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::tests::texture;
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn moments(values: &[f64]) -> (f64, f64) {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64)
    }

    #[test]
    fn one_eighth_of_the_light_remains() {
        let image = texture(320, 240);
        let worse = dark(&image, &mut ChaCha8Rng::seed_from_u64(1));
        let light = |of: &GrayImage| {
            moments(&of.data().iter().map(|v| f64::from(light_of(*v))).collect::<Vec<_>>()).0
        };
        let ratio = light(&worse) / light(&image);
        assert!((ratio * 8.0 - 1.0).abs() < 0.01, "{ratio}");
    }

    /// For a flat gray image the variance of the electrons is their mean plus that of the readout.
    #[test]
    fn noise_variance_is_shot_noise_plus_readout() {
        for stored in [0.3, 0.5, 0.8] {
            let flat = GrayImage::new(400, 300, vec![stored; 120_000]).expect("an image");
            let worse = dark(&flat, &mut ChaCha8Rng::seed_from_u64(2));
            let electrons: Vec<f64> =
                worse.data().iter().map(|v| FULL_WELL * f64::from(light_of(*v))).collect();
            let (mean, variance) = moments(&electrons);
            let expected = FULL_WELL * f64::from(light_of(stored)) / 8.0;
            assert!((mean / expected - 1.0).abs() < 0.02, "{stored}: {mean} of {expected}");
            // Size of one stored level in electrons; rounding is uniform within it.
            let step = FULL_WELL * f64::from(light_of(stored_of(mean as f32 / 4000.0) + 1.0 / 255.0)) - mean;
            let expected = expected + READ_NOISE.powi(2) + step * step / 12.0;
            assert!((variance / expected - 1.0).abs() < 0.05, "{stored}: {variance} of {expected}");
        }
    }

    #[test]
    fn poisson_variance_equals_mean() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for mean in [0.0, 0.7, 12.0, 49.0, 51.0, 400.0] {
            let drawn: Vec<f64> = (0..20_000).map(|_| poisson(mean, &mut rng)).collect();
            let (m, v) = moments(&drawn);
            assert!((m - mean).abs() < 0.05 * mean.sqrt() + 1e-12, "{mean}: {m}");
            assert!((v - mean).abs() < 0.06 * mean + 1e-12, "{mean}: {v}");
        }
    }
}
