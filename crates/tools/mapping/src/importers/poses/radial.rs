//! Conversion of VisualSFM's distortion model to COLMAP's.
//!
//! VisualSFM undistorts measured positions: with `m` in units of the focal length, relative to the centre,
//! `u = m (1 + r |m|²)`. COLMAP distorts projections: `m = u (1 + k₁ |u|² + k₂ |u|⁴)`. Neither is the inverse of the
//! other; `k₁ ≈ −r` alone has errors of several pixels in the corners of a wide image. Here both coefficients are fitted
//! over the image; the remaining error is at most a fifth of a pixel, in the corners.

use veiloc_geometry::nalgebra::{Matrix2, Vector2};
use veiloc_geometry::{Intrinsics, IntrinsicsError};

/// Number of radii of the fit.
const RADII: usize = 64;

/// The camera of an image with this size, its principal point in the centre, with the focal length (pixels) and
/// distortion of an NVM file.
///
/// # Errors
/// [`IntrinsicsError`]: the focal length is not positive, or a number is not finite.
pub fn radial_camera(focal: f64, distortion: f64, (w, h): (u32, u32)) -> Result<Intrinsics, IntrinsicsError> {
    let (cx, cy) = (f64::from(w) / 2.0, f64::from(h) / 2.0);
    if distortion == 0.0 || focal <= 0.0 {
        return Intrinsics::new("SIMPLE_PINHOLE", w, h, &[focal, cx, cy]);
    }
    let [k1, k2] = fitted(distortion, cx.hypot(cy) / focal);
    Intrinsics::new("RADIAL", w, h, &[focal, cx, cy, k1, k2])
}

/// Least squares over the radii of the image: `m/u − 1 = k₁ u² + k₂ u⁴`, multiplied by `u` so that errors are in
/// pixels.
fn fitted(r: f64, corner: f64) -> [f64; 2] {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for k in 1..=RADII {
        let m = corner * k as f64 / RADII as f64;
        let u = m * (1.0 + r * m * m);
        // Where the distortion folds over, a pixel has no unique ray; larger radii are ignored.
        if 1.0 + 3.0 * r * m * m <= 0.05 {
            break;
        }
        let row = Vector2::new(u.powi(3), u.powi(5));
        normal += row * row.transpose();
        right += row * (m - u);
    }
    match normal.try_inverse() {
        Some(inverse) => (inverse * right).into(),
        None => [-r, 0.0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::Pixel;

    #[test]
    fn fitted_distortion_error_is_below_a_fifth_of_a_pixel() {
        // From the Aachen model: db/1045.jpg, db/4446.jpg; the last two with the larger distortion of phones of that
        // time.
        for (focal, r, size) in [
            (1084.59, 0.0810989, (1600, 1067)),
            (1556.98, 0.086426, (1600, 1200)),
            (1084.59, -0.06, (1600, 1067)),
            (1670.0, 0.03, (1920, 1080)),
        ] {
            let camera = radial_camera(focal, r, size).expect("a camera");
            let (cx, cy) = (f64::from(size.0) / 2.0, f64::from(size.1) / 2.0);
            let mut worst: f64 = 0.0;
            for (x, y) in [(0.0, 0.0), (0.25, 0.1), (0.5, 0.5), (0.8, 0.3), (1.0, 1.0), (1.0, 0.5)] {
                let pixel = Pixel::new(x * f64::from(size.0), y * f64::from(size.1));
                let m = Vector2::new((pixel.u - cx) / focal, (pixel.v - cy) / focal);
                let u = m * (1.0 + r * m.norm_squared());
                let ray = camera.unproject(pixel).expect("a ray");
                worst = worst.max((ray.x - u.x).hypot(ray.y - u.y) * focal);
            }
            assert!(worst < 0.2, "f {focal}, r {r}: {worst} px");
        }
        assert_eq!(
            radial_camera(500.0, 0.0, (640, 480)).expect("a camera").to_string(),
            "SIMPLE_PINHOLE,640,480,500,320,240"
        );
        assert!(radial_camera(-1.0, 0.1, (640, 480)).is_err());
    }
}
