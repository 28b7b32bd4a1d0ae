//! Calibrated cameras: projection of rays to pixels and its inverse.

use std::fmt;
use std::str::FromStr;

use nalgebra::Vector2;

use crate::camera_model::{CameraModel, IntrinsicsError};
use crate::pixel::{Pixel, PlanePoint};
use crate::quarter_turns::QuarterTurns;

/// A calibrated camera: its model and its image size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Projection and distortion.
    pub model: CameraModel,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
}

impl Intrinsics {
    /// From COLMAP's model name, image size and parameters.
    ///
    /// # Errors
    /// [`IntrinsicsError`] for an unknown model, a wrong number of parameters, or an invalid value.
    pub fn new(name: &str, width: u32, height: u32, params: &[f64]) -> Result<Self, IntrinsicsError> {
        if width == 0 || height == 0 {
            return Err(IntrinsicsError::BadValue { what: "image size", value: 0.0 });
        }
        Ok(Self { model: CameraModel::new(name, params)?, width, height })
    }

    /// The pixel of a position on the plane `z = 1`, with distortion.
    pub fn project(&self, point: PlanePoint) -> Pixel {
        let ([fx, fy], [cx, cy]) = self.model.pinhole_parts();
        let d = self.model.distortion().distort(Vector2::new(point.x, point.y));
        Pixel::new(fx * d.x + cx, fy * d.y + cy)
    }

    /// The position on the plane `z = 1` that projects to this pixel, undistorted.
    ///
    /// `None` when there is no such position (a pixel beyond the fold of the distortion, 90° from the axis or more, or
    /// not finite).
    pub fn unproject(&self, pixel: Pixel) -> Option<PlanePoint> {
        let ([fx, fy], [cx, cy]) = self.model.pinhole_parts();
        let distorted = Vector2::new((pixel.u - cx) / fx, (pixel.v - cy) / fy);
        let p = self.model.distortion().undistort(distorted)?;
        Some(PlanePoint::new(p.x, p.y))
    }

    /// The same camera without distortion, in which lines in space are lines in the image.
    pub fn pinhole(&self) -> Pinhole {
        let (focal, principal) = self.model.pinhole_parts();
        Pinhole { width: self.width, height: self.height, focal, principal }
    }

    /// The pixel of the same ray in [`Self::pinhole`]; `None` as for [`Self::unproject`].
    pub fn undistort_pixel(&self, pixel: Pixel) -> Option<Pixel> {
        self.unproject(pixel).map(|p| self.pinhole().project(p))
    }

    /// The same camera with focal lengths multiplied by `factor`; the image size is unchanged.
    pub fn zoomed(&self, factor: f64) -> Self {
        let (focal, principal) = self.model.pinhole_parts();
        Self { model: self.model.with_pinhole_parts(focal.map(|f| f * factor), principal), ..*self }
    }

    /// The same camera for an image scaled to another size. Sizes are whole pixels, so the two axes may be scaled
    /// differently; a model with one focal length then becomes the one with two, and the field of view stays.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        let ([fx, fy], [cx, cy]) = self.model.pinhole_parts();
        let model = if sx == sy { self.model } else { self.model.with_two_focals() };
        Self { model: model.with_pinhole_parts([fx * sx, fy * sy], [cx * sx, cy * sy]), width, height }
    }

    /// The camera of a part of the image, `width` × `height` pixels with its first pixel at column `x`, row `y`. What
    /// passthrough cameras of headsets give in another shape than the sensor's is such a part, not a scaled image.
    ///
    /// # Errors
    /// [`IntrinsicsError::Crop`] when the part is empty or not within the image.
    pub fn cropped(&self, x: u32, y: u32, width: u32, height: u32) -> Result<Self, IntrinsicsError> {
        let fits = |first: u32, length: u32, all: u32| {
            length > 0 && first.checked_add(length).is_some_and(|end| end <= all)
        };
        if !(fits(x, width, self.width) && fits(y, height, self.height)) {
            return Err(IntrinsicsError::Crop {
                part: [x, y, width, height],
                size: [self.width, self.height],
            });
        }
        let (focal, [cx, cy]) = self.model.pinhole_parts();
        let model = self.model.with_pinhole_parts(focal, [cx - f64::from(x), cy - f64::from(y)]);
        Ok(Self { model, width, height })
    }

    /// The camera of the turned image. Its axes are turned as well: [`QuarterTurns::turned_from_camera`].
    #[must_use]
    pub fn turned(&self, turns: QuarterTurns) -> Self {
        (0..turns.count()).fold(*self, |camera, _| {
            let ([fx, fy], [cx, cy]) = camera.model.pinhole_parts();
            // The column of a pixel is its distance from the lower border, its row the old column.
            let principal = [f64::from(camera.height) - cy, cx];
            let model = camera.model.with_quarter_turn().with_pinhole_parts([fy, fx], principal);
            Self { model, width: camera.height, height: camera.width }
        })
    }
}

/// Reads a side of an image, pixels. Some programs write it with decimals that are zero (`640.0`).
pub(crate) fn side(text: &str) -> Option<u32> {
    let whole = || {
        let side: f64 = text.parse().ok()?;
        (side.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&side)).then_some(side as u32)
    };
    text.parse().ok().or_else(whole)
}

/// `MODEL,WIDTH,HEIGHT,PARAMS…`, the command line format, or the same with spaces, as in COLMAP's `cameras.txt`.
impl FromStr for Intrinsics {
    type Err = IntrinsicsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let syntax = || IntrinsicsError::Syntax { text: text.to_owned() };
        let has_commas = text.contains(',');
        let is_separator = |c: char| if has_commas { c == ',' } else { c.is_whitespace() };
        // Several spaces are one separator; an empty field between commas is an error.
        let mut parts = text.split(is_separator).map(str::trim).filter(|part| has_commas || !part.is_empty());
        let name = parts.next().filter(|n| !n.is_empty()).ok_or_else(syntax)?;
        let width = parts.next().and_then(side).ok_or_else(syntax)?;
        let height = parts.next().and_then(side).ok_or_else(syntax)?;
        let params: Vec<f64> = parts.map(str::parse).collect::<Result<_, _>>().map_err(|_| syntax())?;
        Self::new(name, width, height, &params)
    }
}

impl fmt::Display for Intrinsics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}", self.model.name(), self.width, self.height)?;
        self.model.params().iter().try_for_each(|p| write!(f, ",{p}"))
    }
}

/// A camera without distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// `[fx, fy]`, pixels.
    pub focal: [f64; 2],
    /// `[cx, cy]`, pixels.
    pub principal: [f64; 2],
}

impl Pinhole {
    /// The pixel of a position on the plane `z = 1`.
    pub fn project(&self, point: PlanePoint) -> Pixel {
        Pixel::new(self.focal[0] * point.x + self.principal[0], self.focal[1] * point.y + self.principal[1])
    }

    /// The position on the plane `z = 1` of a pixel.
    pub fn unproject(&self, pixel: Pixel) -> PlanePoint {
        PlanePoint::new(
            (pixel.u - self.principal[0]) / self.focal[0],
            (pixel.v - self.principal[1]) / self.focal[1],
        )
    }

    /// Whether a pixel is in the image, or at most `margin` pixels outside it.
    pub fn contains(&self, pixel: Pixel, margin: f64) -> bool {
        pixel.u >= -margin
            && pixel.v >= -margin
            && pixel.u <= f64::from(self.width) + margin
            && pixel.v <= f64::from(self.height) + margin
    }

    /// Geometric mean of the two focal lengths: pixels per radian near the centre.
    pub fn mean_focal(&self) -> f64 {
        (self.focal[0] * self.focal[1]).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERAS: [&str; 17] = [
        "SIMPLE_PINHOLE,640,480,525.5,320,240",
        "PINHOLE,1536,1024,1379.74,1382.08,760.6,503.7",
        "SIMPLE_RADIAL,1296,1936,2435.38,648,968,-0.0336422",
        "RADIAL,1000,800,900,500,400,-0.12,0.03",
        "OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007",
        "OPENCV_FISHEYE,1000,800,500,505,510,390,-0.03,0.01,-0.004,0.0005",
        "FULL_OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007,0.01,0.02,-0.01,0.003",
        "FOV,1000,800,500,505,510,390,0.9",
        "SIMPLE_RADIAL_FISHEYE,1000,800,500,510,390,-0.02",
        "RADIAL_FISHEYE,1000,800,500,510,390,-0.02,0.004",
        "THIN_PRISM_FISHEYE,1000,800,500,505,510,390,-0.03,0.01,0.001,-0.0007,-0.004,0.0005,0.002,-0.001",
        "RAD_TAN_THIN_PRISM_FISHEYE,1000,800,500,505,510,390,-0.03,0.01,0.002,-0.004,0.001,-0.0002,0.001,-0.0007,0.002,-0.001,0.0005,0.0003",
        "SIMPLE_DIVISION,1000,800,700,510,390,-0.2",
        "DIVISION,1000,800,700,705,510,390,0.1",
        "SIMPLE_FISHEYE,1000,800,500,510,390",
        "FISHEYE,1000,800,500,505,510,390",
        "EUCM,1000,800,500,505,510,390,0.6,1.1",
    ];

    #[test]
    fn distortion_round_trips_over_the_whole_image() {
        for text in CAMERAS {
            let camera: Intrinsics = text.parse().expect("valid");
            for i in 0..=20 {
                for j in 0..=20 {
                    let pixel = Pixel::new(
                        f64::from(camera.width) * f64::from(i) / 20.0,
                        f64::from(camera.height) * f64::from(j) / 20.0,
                    );
                    let back = camera.project(camera.unproject(pixel).expect("inside the image"));
                    assert!(back.distance(&pixel) < 1e-8, "{text} {pixel:?} -> {back:?}");
                }
            }
            assert_eq!(camera.to_string().parse::<Intrinsics>().expect("its text is readable"), camera);
        }
    }

    #[test]
    fn invalid_cameras_are_rejected() {
        let count = Intrinsics::new("PINHOLE", 640, 480, &[1.0, 2.0, 3.0]).expect_err("three of four");
        assert!(matches!(count, IntrinsicsError::ParameterCount { expected: 4, actual: 3, .. }));
        assert!(Intrinsics::new("PINHOLE", 640, 480, &[1.0, f64::NAN, 3.0, 4.0]).is_err());
        assert!(Intrinsics::new("PINHOLE", 640, 480, &[0.0, 1.0, 3.0, 4.0]).is_err());
        assert!(Intrinsics::new("PINHOLE", 0, 480, &[1.0, 1.0, 3.0, 4.0]).is_err());
        assert!(Intrinsics::new("FOV", 640, 480, &[500.0, 500.0, 320.0, 240.0, 3.2]).is_err());
        assert!("FISHEYE,640,480,1".parse::<Intrinsics>().is_err());
        for (alpha, beta) in [(-0.1, 1.0), (1.1, 1.0), (0.5, 0.0)] {
            assert!(Intrinsics::new("EUCM", 640, 480, &[500.0, 500.0, 320.0, 240.0, alpha, beta]).is_err());
        }
        assert_eq!(Intrinsics::new("EQUIRECTANGULAR", 640, 320, &[]), Err(IntrinsicsError::Panorama));
        for text in ["", "PINHOLE", "PINHOLE,640", "PINHOLE,-1,480,1,1,1,1", "PINHOLE,640,480,x,1,1,1"] {
            assert!(text.parse::<Intrinsics>().is_err(), "{text:?}");
        }
        for text in ["PINHOLE,640.5,480,1,1,1,1", "PINHOLE,-640.0,480,1,1,1,1", "PINHOLE,nan,480,1,1,1,1"] {
            assert!(text.parse::<Intrinsics>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn sizes_with_decimals_and_small_letters_are_read() {
        let camera: Intrinsics = "PINHOLE,640,480,500,500,320,240".parse().expect("valid");
        assert_eq!("pinhole 640.0 480.0 500 500 320 240".parse::<Intrinsics>(), Ok(camera));
        assert_eq!(Intrinsics::new("Pinhole", 640, 480, camera.model.params()), Ok(camera));
        assert!(CameraModel::is_name("simple_radial") && !CameraModel::is_name("room"));
    }

    #[test]
    fn models_have_colmaps_ids_and_parameter_counts() {
        for (id, text) in (0..).zip(["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"]) {
            assert_eq!(CameraModel::from_colmap_id(id).map(|row| row.0), Some(text));
        }
        for text in CAMERAS {
            let model = text.parse::<Intrinsics>().expect("valid").model;
            let row = CameraModel::from_colmap_id(model.colmap_id());
            assert_eq!(row, Some((model.name(), model.params().len())));
            assert!(
                model.params().len() <= CameraModel::MAX_PARAMS && CameraModel::NAMES.contains(model.name())
            );
        }
        assert_eq!(CameraModel::from_colmap_id(17), None);
        assert_eq!(CameraModel::unsupported(17), IntrinsicsError::Panorama);
        assert_eq!(CameraModel::from_colmap_id(-1), None);
    }

    #[test]
    fn turned_camera_sees_the_turned_image() {
        for text in CAMERAS {
            let camera: Intrinsics = text.parse().expect("valid");
            assert_eq!(camera.turned(QuarterTurns::NONE), camera);
            for turns in QuarterTurns::ALL {
                let turned = camera.turned(turns);
                assert_eq!((turned.width, turned.height), turns.size_of((camera.width, camera.height)));
                let back = turned.turned(turns.inverse()).project(PlanePoint::new(0.2, -0.13));
                assert!(back.distance(&camera.project(PlanePoint::new(0.2, -0.13))) < 1e-9, "{text}");
                let ray = turns.turned_from_camera() * nalgebra::Vector3::new(0.2, -0.13, 1.0);
                let Pixel { u, v } = camera.project(PlanePoint::new(0.2, -0.13));
                let (width, height) = (f64::from(camera.width), f64::from(camera.height));
                let moved = match turns.degrees() {
                    0 => Pixel::new(u, v),
                    90 => Pixel::new(height - v, u),
                    180 => Pixel::new(width - u, height - v),
                    _ => Pixel::new(v, width - u),
                };
                let found = turned.project(PlanePoint::new(ray.x, ray.y));
                assert!(found.distance(&moved) < 1e-9, "{text} {turns:?}: {found:?} {moved:?}");
            }
        }
    }

    #[test]
    fn resized_camera_has_the_same_field_of_view() {
        for text in CAMERAS {
            let camera: Intrinsics = text.parse().expect("valid");
            let half = camera.resized(camera.width / 2, camera.height / 2);
            let point = PlanePoint::new(0.2, -0.1);
            let (full, small) = (camera.project(point), half.project(point));
            assert!(small.distance(&Pixel::new(full.u / 2.0, full.v / 2.0)) < 1e-9, "{text}");
            // To a size of another shape, too.
            let odd = camera.resized(333, 250);
            let (sx, sy) = (333.0 / f64::from(camera.width), 250.0 / f64::from(camera.height));
            assert!(odd.project(point).distance(&Pixel::new(full.u * sx, full.v * sy)) < 1e-9, "{text}");
            assert!(camera.zoomed(2.0).pinhole().mean_focal() / camera.pinhole().mean_focal() - 2.0 < 1e-12);
        }
    }

    #[test]
    fn pixels_beyond_the_fold_have_no_ray() {
        let strong: Intrinsics = "SIMPLE_RADIAL,1000,1000,500,500,500,-0.5".parse().expect("valid");
        assert!(strong.unproject(Pixel::new(1000.0, 1000.0)).is_none());
        assert!(strong.unproject(Pixel::new(600.0, 600.0)).is_some());
        assert!(strong.unproject(Pixel::new(f64::NAN, 0.0)).is_none());
    }
}
