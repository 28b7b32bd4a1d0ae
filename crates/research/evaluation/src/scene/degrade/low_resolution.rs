//! Low resolution: the image is reduced until its longer side has 160 pixels, and enlarged to its old size again.
//!
//! Reduction averages the area of each new pixel, enlargement is bilinear: both on stored samples, as common programs
//! do.

use veiloc_features::GrayImage;

use super::with_samples;

/// Pixels of the longer side.
const LONGER_SIDE: u32 = 160;

/// The image with the detail of a small one; an image that is already that small is unchanged.
pub(super) fn low_resolution(image: &GrayImage) -> GrayImage {
    let small = image.clone().limited(LONGER_SIDE);
    let (width, height) = (image.width(), image.height());
    let columns: Vec<Between> = (0..width).map(|u| Between::of(u, width, small.width())).collect();
    let samples = (0..height).flat_map(|v| {
        let at = Between::of(v, height, small.height());
        let (upper, lower) = (small.row(at.first), small.row(at.second));
        let of = |row: &[f32], c: &Between| c.mix(row[c.first as usize], row[c.second as usize]);
        columns.iter().map(|c| at.mix(of(upper, c), of(lower, c))).collect::<Vec<_>>()
    });
    with_samples(image, samples)
}

/// Two neighbours along one axis of the small image, and the weight of the second.
struct Between {
    first: u32,
    second: u32,
    weight: f32,
}

impl Between {
    /// Position of the centre of pixel `at` of `large` among the centres of `small` pixels.
    fn of(at: u32, large: u32, small: u32) -> Self {
        let position = (f64::from(at) + 0.5) * f64::from(small) / f64::from(large) - 0.5;
        let position = position.clamp(0.0, f64::from(small - 1));
        let first = position as u32;
        Self { first, second: (first + 1).min(small - 1), weight: (position - f64::from(first)) as f32 }
    }

    fn mix(&self, first: f32, second: f32) -> f32 {
        first + self.weight * (second - first)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::texture;
    use super::*;

    /// A wave with this period in pixels along each axis.
    fn wave(period: f64) -> GrayImage {
        let at = |i: u32| 0.25 * (std::f64::consts::TAU * f64::from(i) / period).sin();
        let samples = (0..480).flat_map(|v| (0..640).map(move |u| (0.5 + at(u) + at(v)) as f32));
        GrayImage::new(640, 480, samples.collect()).expect("an image")
    }

    fn contrast(image: &GrayImage) -> f64 {
        let mean = image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64;
        let squared: f64 = image.data().iter().map(|v| (f64::from(*v) - mean).powi(2)).sum();
        (squared / image.data().len() as f64).sqrt()
    }

    #[test]
    fn fine_detail_is_lost_and_coarse_detail_kept() {
        let left = |period| contrast(&low_resolution(&wave(period))) / contrast(&wave(period));
        assert!(left(4.0) < 0.05, "{}", left(4.0));
        assert!(left(80.0) > 0.97, "{}", left(80.0));
    }

    /// No shift: a ramp keeps its position, except for the outermost pixels.
    #[test]
    fn low_resolution_does_not_shift() {
        let slope: Vec<f32> = (0..480)
            .flat_map(|v| (0..640).map(move |u| (0.1 + 0.001 * f64::from(u) + 0.0002 * f64::from(v)) as f32))
            .collect();
        let image = GrayImage::new(640, 480, slope).expect("an image");
        let worse = low_resolution(&image);
        for v in (8..472).step_by(31) {
            for u in (8..632).step_by(17) {
                let (a, b) = (worse.row(v)[u], image.row(v)[u]);
                assert!((a - b).abs() < 0.0025, "{u} {v}: {a} {b}");
            }
        }
    }

    #[test]
    fn small_images_are_unchanged() {
        let image = texture(120, 160);
        let same = low_resolution(&image);
        assert!(same.data().iter().zip(image.data()).all(|(a, b)| (a - b).abs() < 0.0025));
    }
}
