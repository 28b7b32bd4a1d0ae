//! Cameras of other programs in COLMAP's models.

use std::path::Path;

use veiloc_geometry::{Intrinsics, Pixel};

use super::posed_input::faulty;
use crate::error::MappingError;

/// Terms that no camera model here has are ignored if they move no corner of the image by more, pixels.
const MAX_IGNORED_PX: f64 = 0.1;

/// A lens with Brown's distortion, as OpenCV has it:
/// `x' = x (1 + k₁ r² + k₂ r⁴ + k₃ r⁶ + k₄ r⁸) + (2 p₁ x y + p₂ (r² + 2 x²)) (1 + p₃ r² + p₄ r⁴)`, `y'` with `p₁` and `p₂`
/// exchanged, `u = f_x x' + skew y' + c_x`. A fisheye has `x θ / r` for `x`, with the same terms.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Lens {
    pub(super) size: (u32, u32),
    pub(super) focal: [f64; 2],
    /// Principal point from the corner, pixels.
    pub(super) principal: [f64; 2],
    /// `k₁` to `k₄`; the fourth term has a model here for fisheyes only.
    pub(super) k: [f64; 4],
    /// `p₁` to `p₄`; the last two have no model here, and a fisheye's none.
    pub(super) p: [f64; 4],
    /// Pixels; has no model here.
    pub(super) skew: f64,
    pub(super) is_fisheye: bool,
}

impl Lens {
    /// The simplest model that has its parameters.
    ///
    /// # Errors
    /// A parameter is invalid, or those that no model has move a corner of the image by more than a tenth of a pixel.
    pub(super) fn intrinsics(&self, path: &Path) -> Result<Intrinsics, MappingError> {
        let Self { size, focal: [fx, fy], principal: [cx, cy], k: [k1, k2, k3, k4], p: [p1, p2, ..], .. } =
            *self;
        let one_focal = fx == fy;
        let no_tangential = p1 == 0.0 && p2 == 0.0;
        let (model, params): (&str, Vec<f64>) = match (k3 == 0.0, no_tangential, k2 == 0.0, k1 == 0.0) {
            _ if self.is_fisheye => ("OPENCV_FISHEYE", vec![fx, fy, cx, cy, k1, k2, k3, k4]),
            (false, ..) => ("FULL_OPENCV", vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
            (_, true, true, true) if one_focal => ("SIMPLE_PINHOLE", vec![fx, cx, cy]),
            (_, true, true, true) => ("PINHOLE", vec![fx, fy, cx, cy]),
            (_, true, true, _) if one_focal => ("SIMPLE_RADIAL", vec![fx, cx, cy, k1]),
            (_, true, ..) if one_focal => ("RADIAL", vec![fx, cx, cy, k1, k2]),
            _ => ("OPENCV", vec![fx, fy, cx, cy, k1, k2, p1, p2]),
        };
        let camera = Intrinsics::new(model, size.0, size.1, &params)
            .map_err(|e| faulty(path, format!("a camera: {e}")))?;
        let moved = self.ignored_px(&camera);
        if moved <= MAX_IGNORED_PX {
            return Ok(camera);
        }
        Err(faulty(
            path,
            format!(
                "terms of the lens that no camera model here has ({}) move a corner of the image by {moved:.3} px; \
                 estimate the camera without them, or export undistorted images",
                self.without_model().join(", ")
            ),
        ))
    }

    /// How far the terms without a model move a corner of the image, pixels.
    fn ignored_px(&self, camera: &Intrinsics) -> f64 {
        if self.without_model().is_empty() {
            return 0.0;
        }
        let ([fx, fy], [p1, p2, p3, p4]) = (self.focal, self.p);
        let (w, h) = (f64::from(self.size.0), f64::from(self.size.1));
        let moved = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(u, v)| {
            let distorted = ((u - self.principal[0]) / fx, (v - self.principal[1]) / fy);
            let ray = camera.unproject(Pixel::new(u, v)).filter(|_| !self.is_fisheye);
            let (x, y) = ray.map_or(distorted, |ray| (ray.x, ray.y));
            let r2 = x * x + y * y;
            let radial = if self.is_fisheye { 0.0 } else { self.k[3] * r2.powi(4) };
            let tangential = p3 * r2 + p4 * r2 * r2 + if self.is_fisheye { 1.0 } else { 0.0 };
            let dx = x * radial + (2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) * tangential;
            let dy = y * radial + (2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)) * tangential;
            (fx * dx + self.skew * distorted.1).hypot(fy * dy)
        });
        moved.into_iter().fold(0.0, |most, px| if px.is_nan() { px } else { px.max(most) })
    }

    /// The names of its terms that no model has.
    fn without_model(&self) -> Vec<&'static str> {
        let terms = [
            ("k4", if self.is_fisheye { 0.0 } else { self.k[3] }),
            ("p1", if self.is_fisheye { self.p[0] } else { 0.0 }),
            ("p2", if self.is_fisheye { self.p[1] } else { 0.0 }),
            ("p3", self.p[2]),
            ("p4", self.p[3]),
            ("skew", self.skew),
        ];
        terms.into_iter().filter(|(_, value)| *value != 0.0).map(|(name, _)| name).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_below_a_tenth_of_a_pixel_at_the_corner_are_ignored() {
        let pinhole =
            Lens { size: (640, 480), focal: [500.0; 2], principal: [320.0, 240.0], ..Lens::default() };
        let barrel = Lens { k: [-0.3, 0.1, 0.0, 0.0], ..pinhole };
        let fisheye = Lens { k: [0.01, 0.0, 0.0, 0.02], is_fisheye: true, ..pinhole };
        // A corner is 0.8 from the axis: a term k4 moves it by 500 · 0.8⁹ k4 = 67.1 k4.
        let radial = |lens: Lens, k4: f64| Lens { k: [lens.k[0], lens.k[1], 0.0, k4], ..lens };
        let tangential = |lens: Lens, at: usize, value: f64| {
            let mut p = [0.0; 4];
            p[at] = value;
            // p3 and p4 scale p1 and p2.
            if at > 1 {
                p[0] = 0.01;
            }
            Lens { p, ..lens }
        };
        let cases: [(Lens, Option<&str>); 14] = [
            (radial(pinhole, 1e-9), None),
            (radial(pinhole, 0.0014), None),
            (radial(pinhole, -0.0016), Some("(k4) move a corner of the image by 0.107 px")),
            // The ray of a corner is farther from the axis than the corner.
            (radial(barrel, 0.0010), Some("k4")),
            (Lens { skew: 0.012, ..pinhole }, None),
            (Lens { skew: 0.3, ..pinhole }, Some("skew")),
            (tangential(pinhole, 0, 0.01), None),
            (tangential(pinhole, 2, 0.001), None),
            (tangential(pinhole, 2, 0.5), Some("p3")),
            (tangential(pinhole, 3, 0.5), Some("p4")),
            (fisheye, None),
            (tangential(fisheye, 0, 1e-4), None),
            (tangential(fisheye, 1, 0.01), Some("p2")),
            (radial(pinhole, f64::NAN), Some("k4")),
        ];
        for (lens, refused) in cases {
            let camera = lens.intrinsics(Path::new("a")).map_err(|error| error.to_string());
            match refused {
                None => assert!(camera.is_ok(), "{lens:?}: {camera:?}"),
                Some(part) => {
                    assert!(camera.as_ref().is_err_and(|e| e.contains(part)), "{lens:?}: {camera:?}");
                }
            }
        }
    }
}
