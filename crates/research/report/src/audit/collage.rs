//! In place of the paper's Fig. 6, which needs its trained inversion networks: every keypoint's patch of the photograph,
//! set where an attack puts the keypoint.
//!
//! The patches are the true ones, which no attacker holds: an attacker has descriptors, and a network that makes pixels
//! of them. So a collage shows what the recovered *positions* are worth, not what an inversion network would draw.

use image::{Rgb, RgbImage};
use veiloc_geometry::Pixel;

/// Half the side of a patch, in shares of the image's longer side: 8 px of 640.
const HALF_PATCH: f64 = 8.0 / 640.0;
/// Where no patch lies.
const NOTHING: Rgb<u8> = Rgb([118, 122, 126]);

/// The collage of one attack. Patches are discs; later keypoints, which are the weaker ones, lie below.
pub(super) fn collage(photograph: &RgbImage, truth: &[Pixel], answers: &[Pixel]) -> RgbImage {
    let (w, h) = photograph.dimensions();
    let half = (HALF_PATCH * f64::from(w.max(h))).ceil() as i64;
    let mut out = RgbImage::from_pixel(w, h, NOTHING);
    for (from, to) in truth.iter().zip(answers).rev() {
        if !(from.is_finite() && to.u.abs() < 1e6 && to.v.abs() < 1e6) {
            continue;
        }
        // The first pixel's centre is at (0.5, 0.5).
        let whole = |p: &Pixel| (p.u.floor() as i64, p.v.floor() as i64);
        let ((fx, fy), (tx, ty)) = (whole(from), whole(to));
        for dy in -half..=half {
            for dx in -half..=half {
                let inside =
                    |x: i64, y: i64| (0..i64::from(w)).contains(&x) && (0..i64::from(h)).contains(&y);
                if dx * dx + dy * dy <= half * half && inside(fx + dx, fy + dy) && inside(tx + dx, ty + dy) {
                    let pixel = *photograph.get_pixel((fx + dx) as u32, (fy + dy) as u32);
                    out.put_pixel((tx + dx) as u32, (ty + dy) as u32, pixel);
                }
            }
        }
    }
    out
}

/// Mean absolute difference of two images of one size, 0 to 255: how far a collage is from the photograph.
#[cfg(test)]
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let pairs = a.as_raw().iter().zip(b.as_raw());
    pairs.map(|(x, y)| f64::from(x.abs_diff(*y))).sum::<f64>() / a.as_raw().len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_positions_give_the_image_back_and_wrong_ones_do_not() {
        let photograph = RgbImage::from_fn(160, 120, |x, y| {
            let wave = 120.0 + 100.0 * (f64::from(x) / 9.0).sin() * (f64::from(y) / 7.0).cos();
            Rgb([wave as u8, x as u8, y as u8])
        });
        let truth: Vec<Pixel> = (0..80 * 60)
            .map(|i| Pixel::new(f64::from(i % 80) * 2.0 + 0.5, f64::from(i / 80) * 2.0 + 0.5))
            .collect();
        let same = collage(&photograph, &truth, &truth);
        assert_eq!(difference(&same, &photograph), 0.0, "patches that overlap everywhere");
        let gathered = vec![Pixel::new(80.0, 0.0); truth.len()];
        assert!(difference(&collage(&photograph, &truth, &gathered), &photograph) > 30.0);
        let wild = [Pixel::new(f64::NAN, 0.0), Pixel::new(1e300, 0.0), Pixel::new(-1e5, 0.0)];
        let empty = collage(&photograph, &truth, &wild);
        assert!(empty.pixels().all(|p| *p == NOTHING));
    }
}
