//! Equirectangular panoramas, and the pinhole images that cover one.
//!
//! A panorama sees all directions, so it has no pinhole camera. It becomes a rig of pinhole images: the four sides and the top of
//! a cube, which share its centre and whose relative poses are exact. No direction is in two of them. The bottom is left out: it
//! shows the tripod, or the hand that holds the camera.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::frames::Rig;
use crate::{CameraFromRig, Intrinsics, Pixel, Point3};

/// An equirectangular panorama: columns are longitudes and rows are latitudes, as in COLMAP's model `EQUIRECTANGULAR`.
///
/// ```text
/// u = (0.5 + atan2(x, z) / 2π) · width        v = (0.5 + asin(y) / π) · height
/// ```
///
/// for a direction of unit length in its frame: `x` right, `y` down, `z` to the middle of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Panorama {
    width: u32,
    height: u32,
}

/// A pinhole image that a panorama becomes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanoramaFace {
    /// `front`, `right`, `back`, `left` or `up`.
    pub name: &'static str,
    /// Its pose on the rig, whose frame is that of the panorama.
    pub cam_from_rig: CameraFromRig,
    /// Its camera: a square of 90° by 90°, with the resolution of the panorama in its middle.
    pub camera: Intrinsics,
}

impl Panorama {
    /// A panorama of this size, pixels; `None` unless it is twice as wide as high, to a pixel, and at least 256 pixels wide.
    pub fn new(width: u32, height: u32) -> Option<Self> {
        let is_whole = width.abs_diff(height.checked_mul(2)?) <= 1 && width >= 256;
        is_whole.then_some(Self { width, height })
    }

    /// Columns.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// The pixel of a direction of any length above 0.
    pub fn project(&self, direction: &Vector3<f64>) -> Pixel {
        let latitude = direction.y.atan2(direction.x.hypot(direction.z));
        Pixel {
            u: (0.5 + direction.x.atan2(direction.z) / (2.0 * PI)) * f64::from(self.width),
            v: (0.5 + latitude / PI) * f64::from(self.height),
        }
    }

    /// The direction of a pixel, of unit length: the inverse.
    pub fn direction(&self, pixel: &Pixel) -> Vector3<f64> {
        let longitude = (pixel.u / f64::from(self.width) - 0.5) * 2.0 * PI;
        let latitude = (pixel.v / f64::from(self.height) - 0.5) * PI;
        Vector3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos())
    }

    /// The images that it becomes.
    pub fn faces(&self) -> [PanoramaFace; 5] {
        // The focal length at which a pixel in the middle covers as much as one of the panorama.
        let side = (f64::from(self.width) / PI).round();
        let camera = Intrinsics::new("SIMPLE_PINHOLE", side as u32, side as u32, &[0.5 * side; 3])
            .expect("a square of at least 81 pixels with half of it as focal length");
        let face = |name, rotation| {
            let cam_from_rig = CameraFromRig::new(rotation, Vector3::zeros());
            PanoramaFace { name, cam_from_rig, camera }
        };
        let about = |quarters: f64| Rotation3::from_axis_angle(&-Vector3::y_axis(), quarters * FRAC_PI_2);
        let up = Rotation3::from_matrix_unchecked(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0));
        [
            face("front", about(0.0)),
            face("right", about(1.0)),
            face("back", about(2.0)),
            face("left", about(3.0)),
            face("up", up),
        ]
    }
}

impl PanoramaFace {
    /// The direction of a pixel of this image, in the frame of the panorama.
    pub fn direction(&self, pixel: &Pixel) -> Vector3<f64> {
        let half = 0.5 * f64::from(self.camera.width);
        let in_camera = Vector3::new(pixel.u - half, pixel.v - half, half);
        self.cam_from_rig.inverse().transform(&Point3::from_vector(in_camera)).coords
    }

    /// The pixel of this image that a direction in the frame of the panorama has; `None` outside of it.
    pub fn project(&self, direction: &Vector3<f64>) -> Option<Pixel> {
        let point = self.cam_from_rig.transform(&Point3::<Rig>::from_vector(*direction));
        let side = f64::from(self.camera.width);
        let at = |offset: f64| 0.5 * side * (1.0 + offset / point.coords.z);
        let pixel = Pixel::new(at(point.coords.x), at(point.coords.y));
        let is_inside = |at: f64| (0.0..side).contains(&at);
        (point.depth() > 0.0 && is_inside(pixel.u) && is_inside(pixel.v)).then_some(pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_cover_all_directions_but_the_bottom_once() {
        let panorama = Panorama::new(1024, 512).expect("2:1");
        let faces = panorama.faces();
        for k in 0..5000 {
            let (v, u) = ((f64::from(k) + 0.5) / 5000.0, 0.618_033_988_7 * f64::from(k));
            let (y, angle) = (2.0 * v - 1.0, 2.0 * PI * u.fract());
            let around = (1.0 - y * y).sqrt();
            let direction = Vector3::new(around * angle.sin(), y, around * angle.cos());
            let seen: Vec<_> = faces.iter().filter_map(|f| Some((f, f.project(&direction)?))).collect();
            let is_bottom = y > direction.x.abs().max(direction.z.abs());
            assert_eq!(seen.len(), usize::from(!is_bottom), "{direction}");
            for (face, pixel) in seen {
                assert!(face.direction(&pixel).normalize().dot(&direction) > 1.0 - 1e-12, "{}", face.name);
            }
        }
    }

    #[test]
    fn pixels_are_those_of_the_definition() {
        let panorama = Panorama::new(1024, 512).expect("2:1");
        for (direction, [u, v]) in [
            ([0.0, 0.0, 1.0], [512.0, 256.0]),
            ([2.0, 0.0, 0.0], [768.0, 256.0]),
            ([-1.0, 0.0, 0.0], [256.0, 256.0]),
            ([0.0, -1.0, 0.0], [512.0, 0.0]),
            ([0.0, 1.0, 1.0], [512.0, 384.0]),
        ] {
            let pixel = panorama.project(&Vector3::from(direction));
            assert!(pixel.distance(&Pixel::new(u, v)) < 1e-9, "{direction:?}: {pixel:?}");
            let back = panorama.direction(&pixel);
            assert!((back - Vector3::from(direction).normalize()).norm() < 1e-12, "{direction:?}: {back}");
        }
        for (width, height) in [(1000, 400), (1000, 502), (200, 100), (u32::MAX, u32::MAX)] {
            assert_eq!(Panorama::new(width, height), None);
        }
    }
}
