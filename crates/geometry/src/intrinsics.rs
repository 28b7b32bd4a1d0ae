//! Camera models: COLMAP's names and parameter order, distortion and its inverse.

use std::fmt;
use std::str::FromStr;

use nalgebra::{Matrix2, Vector2};

use crate::pixel::{Pixel, PlanePoint};

/// Why intrinsics were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IntrinsicsError {
    /// The model has no such name, or is one that is not supported.
    #[error(
        "camera model {name:?} is not supported; supported are SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL and OPENCV"
    )]
    UnknownModel {
        /// The name as given.
        name: String,
    },
    /// The model takes another number of parameters.
    #[error("camera model {model} takes {expected} parameters ({order}), {actual} were given")]
    ParameterCount {
        /// COLMAP's name of the model.
        model: &'static str,
        /// Its parameters in order.
        order: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many were given.
        actual: usize,
    },
    /// A number is NaN, infinite, or not positive where it must be.
    #[error("camera {what} is {value}, which no camera has")]
    BadValue {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A text did not follow `MODEL,WIDTH,HEIGHT,PARAMS…`.
    #[error(
        "camera {text:?} does not read as MODEL,WIDTH,HEIGHT,PARAMS… (for example PINHOLE,640,480,525,525,320,240)"
    )]
    Syntax {
        /// The text as given.
        text: String,
    },
}

/// How a ray becomes a pixel; parameters in COLMAP's order, focal lengths and principal point in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum CameraModel {
    /// `f, cx, cy`
    SimplePinhole([f64; 3]),
    /// `fx, fy, cx, cy`
    Pinhole([f64; 4]),
    /// `f, cx, cy, k`
    SimpleRadial([f64; 4]),
    /// `f, cx, cy, k1, k2`
    Radial([f64; 5]),
    /// `fx, fy, cx, cy, k1, k2, p1, p2`
    OpenCv([f64; 8]),
}

impl CameraModel {
    /// Builds a model from COLMAP's name and parameters.
    ///
    /// # Errors
    /// [`IntrinsicsError`] when the name is unknown, the count is wrong, or a value is impossible.
    pub fn new(name: &str, params: &[f64]) -> Result<Self, IntrinsicsError> {
        fn take<const N: usize>(
            model: &'static str,
            order: &'static str,
            params: &[f64],
        ) -> Result<[f64; N], IntrinsicsError> {
            params.try_into().map_err(|_| IntrinsicsError::ParameterCount {
                model,
                order,
                expected: N,
                actual: params.len(),
            })
        }
        let model = match name {
            "SIMPLE_PINHOLE" => Self::SimplePinhole(take("SIMPLE_PINHOLE", "f, cx, cy", params)?),
            "PINHOLE" => Self::Pinhole(take("PINHOLE", "fx, fy, cx, cy", params)?),
            "SIMPLE_RADIAL" => Self::SimpleRadial(take("SIMPLE_RADIAL", "f, cx, cy, k", params)?),
            "RADIAL" => Self::Radial(take("RADIAL", "f, cx, cy, k1, k2", params)?),
            "OPENCV" => Self::OpenCv(take("OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2", params)?),
            _ => return Err(IntrinsicsError::UnknownModel { name: name.to_owned() }),
        };
        if let Some(&value) = params.iter().find(|p| !p.is_finite()) {
            return Err(IntrinsicsError::BadValue { what: "parameter", value });
        }
        if let Some(value) = model.pinhole_parts().0.into_iter().find(|f| *f <= 0.0) {
            return Err(IntrinsicsError::BadValue { what: "focal length", value });
        }
        Ok(model)
    }

    /// COLMAP's name.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::SimplePinhole(_) => "SIMPLE_PINHOLE",
            Self::Pinhole(_) => "PINHOLE",
            Self::SimpleRadial(_) => "SIMPLE_RADIAL",
            Self::Radial(_) => "RADIAL",
            Self::OpenCv(_) => "OPENCV",
        }
    }

    /// COLMAP's number of the model, as in its binary files.
    pub const fn colmap_id(&self) -> i32 {
        match self {
            Self::SimplePinhole(_) => 0,
            Self::Pinhole(_) => 1,
            Self::SimpleRadial(_) => 2,
            Self::Radial(_) => 3,
            Self::OpenCv(_) => 4,
        }
    }

    /// Name and number of parameters of COLMAP's model number; `None` for models not supported here.
    pub const fn from_colmap_id(id: i32) -> Option<(&'static str, usize)> {
        match id {
            0 => Some(("SIMPLE_PINHOLE", 3)),
            1 => Some(("PINHOLE", 4)),
            2 => Some(("SIMPLE_RADIAL", 4)),
            3 => Some(("RADIAL", 5)),
            4 => Some(("OPENCV", 8)),
            _ => None,
        }
    }

    /// The parameters in COLMAP's order.
    pub const fn params(&self) -> &[f64] {
        match self {
            Self::SimplePinhole(p) => p,
            Self::Pinhole(p) | Self::SimpleRadial(p) => p,
            Self::Radial(p) => p,
            Self::OpenCv(p) => p,
        }
    }

    /// `([fx, fy], [cx, cy])`
    const fn pinhole_parts(&self) -> ([f64; 2], [f64; 2]) {
        match *self {
            Self::SimplePinhole([f, cx, cy])
            | Self::SimpleRadial([f, cx, cy, _])
            | Self::Radial([f, cx, cy, ..]) => ([f, f], [cx, cy]),
            Self::Pinhole([fx, fy, cx, cy]) | Self::OpenCv([fx, fy, cx, cy, ..]) => ([fx, fy], [cx, cy]),
        }
    }

    /// `[k1, k2, p1, p2]`, zero where the model has none.
    const fn distortion(&self) -> [f64; 4] {
        match *self {
            Self::SimplePinhole(_) | Self::Pinhole(_) => [0.0; 4],
            Self::SimpleRadial([_, _, _, k]) => [k, 0.0, 0.0, 0.0],
            Self::Radial([_, _, _, k1, k2]) => [k1, k2, 0.0, 0.0],
            Self::OpenCv([_, _, _, _, k1, k2, p1, p2]) => [k1, k2, p1, p2],
        }
    }
}

/// A calibrated camera: its model and the size of its images.
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
    /// [`IntrinsicsError`] for an unknown model, a wrong count, or an impossible value.
    pub fn new(name: &str, width: u32, height: u32, params: &[f64]) -> Result<Self, IntrinsicsError> {
        if width == 0 || height == 0 {
            return Err(IntrinsicsError::BadValue { what: "image size", value: 0.0 });
        }
        Ok(Self { model: CameraModel::new(name, params)?, width, height })
    }

    /// The pixel of a position on the plane `z = 1`, with distortion.
    pub fn project(&self, point: PlanePoint) -> Pixel {
        let ([fx, fy], [cx, cy]) = self.model.pinhole_parts();
        let d = distort(self.model.distortion(), Vector2::new(point.x, point.y));
        Pixel::new(fx * d.x + cx, fy * d.y + cy)
    }

    /// The position on the plane `z = 1` that projects to this pixel: distortion undone.
    ///
    /// `None` when no such position is found (a pixel beyond where the distortion folds back, or not finite).
    pub fn unproject(&self, pixel: Pixel) -> Option<PlanePoint> {
        let ([fx, fy], [cx, cy]) = self.model.pinhole_parts();
        let distorted = Vector2::new((pixel.u - cx) / fx, (pixel.v - cy) / fy);
        let p = undistort(self.model.distortion(), distorted)?;
        Some(PlanePoint::new(p.x, p.y))
    }

    /// The same camera without its distortion: where lines in space are lines in the image.
    pub fn pinhole(&self) -> Pinhole {
        let (focal, principal) = self.model.pinhole_parts();
        Pinhole { width: self.width, height: self.height, focal, principal }
    }

    /// The pixel the same ray has in [`Self::pinhole`]; `None` as for [`Self::unproject`].
    pub fn undistort_pixel(&self, pixel: Pixel) -> Option<Pixel> {
        self.unproject(pixel).map(|p| self.pinhole().project(p))
    }

    /// The same camera with focal lengths so many times as long; the size of the image stays.
    pub fn zoomed(&self, factor: f64) -> Self {
        let mut model = self.model;
        match &mut model {
            CameraModel::SimplePinhole([f, ..])
            | CameraModel::SimpleRadial([f, ..])
            | CameraModel::Radial([f, ..]) => *f *= factor,
            CameraModel::Pinhole([fx, fy, ..]) | CameraModel::OpenCv([fx, fy, ..]) => {
                *fx *= factor;
                *fy *= factor;
            }
        }
        Self { model, ..*self }
    }

    /// The same camera for an image scaled to another size.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        let s = (sx * sy).sqrt();
        let model = match self.model {
            CameraModel::SimplePinhole([f, cx, cy]) => CameraModel::SimplePinhole([f * s, cx * sx, cy * sy]),
            CameraModel::Pinhole([fx, fy, cx, cy]) => {
                CameraModel::Pinhole([fx * sx, fy * sy, cx * sx, cy * sy])
            }
            CameraModel::SimpleRadial([f, cx, cy, k]) => {
                CameraModel::SimpleRadial([f * s, cx * sx, cy * sy, k])
            }
            CameraModel::Radial([f, cx, cy, k1, k2]) => {
                CameraModel::Radial([f * s, cx * sx, cy * sy, k1, k2])
            }
            CameraModel::OpenCv([fx, fy, cx, cy, k1, k2, p1, p2]) => {
                CameraModel::OpenCv([fx * sx, fy * sy, cx * sx, cy * sy, k1, k2, p1, p2])
            }
        };
        Self { model, width, height }
    }
}

/// `MODEL,WIDTH,HEIGHT,PARAMS…`, as on the command line.
impl FromStr for Intrinsics {
    type Err = IntrinsicsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let syntax = || IntrinsicsError::Syntax { text: text.to_owned() };
        let mut parts = text.split(',').map(str::trim);
        let name = parts.next().filter(|n| !n.is_empty()).ok_or_else(syntax)?;
        let width = parts.next().and_then(|p| p.parse().ok()).ok_or_else(syntax)?;
        let height = parts.next().and_then(|p| p.parse().ok()).ok_or_else(syntax)?;
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

    /// Whether a pixel lies in the image, or at most `margin` pixels outside it.
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

/// Brown–Conrady distortion of COLMAP's OPENCV model on the plane `z = 1`.
fn distort([k1, k2, p1, p2]: [f64; 4], p: Vector2<f64>) -> Vector2<f64> {
    let (xx, yy, xy) = (p.x * p.x, p.y * p.y, p.x * p.y);
    let r2 = xx + yy;
    let radial = 1.0 + r2 * (k1 + k2 * r2);
    Vector2::new(
        p.x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx),
        p.y * radial + 2.0 * p2 * xy + p1 * (r2 + 2.0 * yy),
    )
}

fn distort_jacobian([k1, k2, p1, p2]: [f64; 4], p: Vector2<f64>) -> Matrix2<f64> {
    let (x, y) = (p.x, p.y);
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + k2 * r2);
    let slope = 2.0 * (k1 + 2.0 * k2 * r2);
    let off = slope * x * y + 2.0 * (p1 * x + p2 * y);
    Matrix2::new(
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        off,
        off,
        radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y,
    )
}

/// Newton's method on the distortion, from the distorted position; strictly checked at the end.
fn undistort(k: [f64; 4], target: Vector2<f64>) -> Option<Vector2<f64>> {
    if !(target.x.is_finite() && target.y.is_finite()) {
        return None;
    }
    if k == [0.0; 4] {
        return Some(target);
    }
    let mut p = target;
    for _ in 0..50 {
        let residual = distort(k, p) - target;
        let step = distort_jacobian(k, p).try_inverse()? * residual;
        p -= step;
        if step.norm() < 1e-14 * (1.0 + p.norm()) {
            break;
        }
    }
    // Beyond its fold a polynomial distortion has other roots; the true one keeps the orientation of the plane.
    let solved = (distort(k, p) - target).norm() < 1e-10 * (1.0 + target.norm());
    let unfolded = distort_jacobian(k, p).determinant() > 0.0 && p.dot(&target) >= 0.0;
    (solved && unfolded).then_some(p)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERAS: [&str; 5] = [
        "SIMPLE_PINHOLE,640,480,525.5,320,240",
        "PINHOLE,1536,1024,1379.74,1382.08,760.6,503.7",
        "SIMPLE_RADIAL,1296,1936,2435.38,648,968,-0.0336422",
        "RADIAL,1000,800,900,500,400,-0.12,0.03",
        "OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007",
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
            assert_eq!(camera.to_string().parse::<Intrinsics>().expect("prints what it reads"), camera);
        }
    }

    #[test]
    fn jacobian_agrees_with_finite_differences() {
        let k = [-0.15, 0.05, 0.001, -0.0007];
        let p = Vector2::new(0.31, -0.47);
        let h = 1e-6;
        let j = distort_jacobian(k, p);
        for c in 0..2 {
            let mut step = Vector2::zeros();
            step[c] = h;
            let numeric = (distort(k, p + step) - distort(k, p - step)) / (2.0 * h);
            assert!((numeric - j.column(c)).norm() < 1e-9);
        }
    }

    #[test]
    fn impossible_cameras_are_refused() {
        let count = Intrinsics::new("PINHOLE", 640, 480, &[1.0, 2.0, 3.0]).expect_err("three of four");
        assert!(matches!(count, IntrinsicsError::ParameterCount { expected: 4, actual: 3, .. }));
        assert!(Intrinsics::new("PINHOLE", 640, 480, &[1.0, f64::NAN, 3.0, 4.0]).is_err());
        assert!(Intrinsics::new("PINHOLE", 640, 480, &[0.0, 1.0, 3.0, 4.0]).is_err());
        assert!(Intrinsics::new("PINHOLE", 0, 480, &[1.0, 1.0, 3.0, 4.0]).is_err());
        assert!("FISHEYE,640,480,1".parse::<Intrinsics>().is_err());
        for text in ["", "PINHOLE", "PINHOLE,640", "PINHOLE,-1,480,1,1,1,1", "PINHOLE,640,480,x,1,1,1"] {
            assert!(text.parse::<Intrinsics>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn a_pixel_beyond_the_fold_has_no_ray() {
        let strong: Intrinsics = "SIMPLE_RADIAL,1000,1000,500,500,500,-0.5".parse().expect("valid");
        assert!(strong.unproject(Pixel::new(1000.0, 1000.0)).is_none());
        assert!(strong.unproject(Pixel::new(600.0, 600.0)).is_some());
        assert!(strong.unproject(Pixel::new(f64::NAN, 0.0)).is_none());
    }
}
