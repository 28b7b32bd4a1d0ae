//! Motion blur: the image moves at constant speed along a straight line during the exposure, and each pixel averages
//! over it.
//!
//! The average is over light, not over stored samples, since a sensor adds photons. The motion is half before and
//! half after the true pose, so that the pose stays valid. Beyond the border the outermost pixel is repeated.

use rand::Rng;
use veiloc_features::GrayImage;

use super::srgb::{light_of, stored_of};
use super::with_samples;

/// Length of the motion relative to the longer side of the image: 13 pixels of 640.
const LENGTH: f64 = 13.0 / 640.0;

/// Samples of the exposure per pixel of motion.
const STEPS_A_PIXEL: f64 = 2.0;

/// The image moved along a random direction.
pub(super) fn motion_blurred(image: &GrayImage, rng: &mut impl Rng) -> GrayImage {
    let length = LENGTH * f64::from(image.width().max(image.height()));
    moved_along(image, length, rng.random_range(0.0..std::f64::consts::PI))
}

/// The image moved by `length` pixels in the direction `angle` from the `u` axis towards `v`, radians.
fn moved_along(image: &GrayImage, length: f64, angle: f64) -> GrayImage {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let light: Vec<f32> = image.data().iter().map(|v| light_of(*v)).collect();
    let steps = (STEPS_A_PIXEL * length).ceil().max(1.0) as usize;
    let mut sum = vec![0.0f32; light.len()];
    for step in 0..steps {
        let along = length * ((step as f64 + 0.5) / steps as f64 - 0.5);
        add_shifted(&mut sum, &light, (width, height), [along * angle.cos(), along * angle.sin()]);
    }
    with_samples(image, sum.into_iter().map(|s| stored_of(s / steps as f32)))
}

/// Adds the light of each pixel of the shifted image, with bilinear interpolation.
fn add_shifted(sum: &mut [f32], light: &[f32], (width, height): (usize, usize), shift: [f64; 2]) {
    let [(du, wu), (dv, wv)] = shift.map(|s| (s.floor() as isize, (s - s.floor()) as f32));
    let inside = |at: isize, count: usize| at.clamp(0, count as isize - 1) as usize;
    for v in 0..height {
        let rows = [0, 1].map(|k| &light[inside(v as isize + dv + k, height) * width..][..width]);
        for u in 0..width {
            let [left, right] = [0, 1].map(|k| inside(u as isize + du + k, width));
            let [upper, lower] = rows.map(|row| (1.0 - wu) * row[left] + wu * row[right]);
            sum[v * width + u] += (1.0 - wv) * upper + wv * lower;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::texture;
    use super::*;

    fn light(image: &GrayImage) -> f64 {
        image.data().iter().map(|v| f64::from(light_of(*v))).sum()
    }

    #[test]
    fn bright_pixel_becomes_a_streak_of_motion_length() {
        let mut samples = vec![0.0; 101 * 101];
        samples[50 * 101 + 50] = 1.0;
        let image = GrayImage::new(101, 101, samples).expect("an image");
        // The light is spread over 13 pixels along the motion, and one across: enough to be visible in 8 bits.
        for (angle, along_u) in [(0.0, true), (std::f64::consts::FRAC_PI_2, false)] {
            let worse = moved_along(&image, 13.0, angle);
            let at = |u: usize, v: usize| worse.data()[v * 101 + u];
            let streak: Vec<usize> =
                (0..101).filter(|i| if along_u { at(*i, 50) > 0.0 } else { at(50, *i) > 0.0 }).collect();
            assert_eq!((streak[0], streak[streak.len() - 1]), (43, 57), "the ends are faint");
            let bright = streak.iter().filter(|i| {
                light_of(at(if along_u { **i } else { 50 }, if along_u { 50 } else { **i })) > 0.8 / 13.0
            });
            assert_eq!(bright.count(), 13);
            assert!((light(&worse) - 1.0).abs() < 0.02, "{}", light(&worse));
        }
    }

    #[test]
    fn motion_blur_conserves_light_and_removes_edges() {
        let image = texture(320, 240);
        let worse = moved_along(&image, 6.5, 0.7);
        assert!((light(&worse) / light(&image) - 1.0).abs() < 0.01);
        let steps = |of: &GrayImage| -> f64 {
            (0..240).flat_map(|v| of.row(v).windows(2)).map(|w| f64::from(w[1] - w[0]).powi(2)).sum()
        };
        assert!(steps(&worse) < 0.5 * steps(&image));
        assert!(
            moved_along(&image, 0.0, 0.7).data().iter().zip(image.data()).all(|(a, b)| (a - b).abs() < 0.003)
        );
    }
}
