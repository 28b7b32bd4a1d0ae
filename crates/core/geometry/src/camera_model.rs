//! COLMAP's camera models: names, numbers and parameters.

use crate::distortion::{Distortion, Planar};

/// Why intrinsics were rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IntrinsicsError {
    /// The model name is unknown or not supported.
    #[error("camera model {name:?} is not supported; supported are {}", CameraModel::NAMES)]
    UnknownModel {
        /// The given name.
        name: String,
    },
    /// A panorama.
    #[error(
        "camera model EQUIRECTANGULAR is not supported: a panorama sees more than half of the directions, and has no pinhole \
         image; cut it into perspective images first"
    )]
    Panorama,
    /// Wrong number of parameters for the model.
    #[error("camera model {model} takes {expected} parameters ({order}), {actual} were given")]
    ParameterCount {
        /// COLMAP's name of the model.
        model: &'static str,
        /// Its parameters in order.
        order: &'static str,
        /// Expected number.
        expected: usize,
        /// Given number.
        actual: usize,
    },
    /// A number is NaN, infinite, or not positive where it must be.
    #[error("camera {what} is {value}, which no camera has")]
    BadValue {
        /// The number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A part of an image that is empty or not within it.
    #[error(
        "the part of {} x {} pixels at ({}, {}) is not within the image of {} x {} pixels",
        .part[2], .part[3], .part[0], .part[1], .size[0], .size[1]
    )]
    Crop {
        /// Column and row of its first pixel, width, height.
        part: [u32; 4],
        /// Width and height of the image.
        size: [u32; 2],
    },
    /// The text is not of the form `MODEL,WIDTH,HEIGHT,PARAMS…`.
    #[error(
        "camera {text:?} does not read as MODEL,WIDTH,HEIGHT,PARAMS… (for example PINHOLE,640,480,525,525,320,240)"
    )]
    Syntax {
        /// The given text.
        text: String,
    },
}

/// Projection of a ray to a pixel; parameters in COLMAP's order, focal lengths and principal point in pixels.
///
/// Distortion maps the position on the plane `z = 1`, at distance `r` from the axis (`θ = atan r`), to the observed
/// position:
///
/// | models | observed at |
/// |---|---|
/// | pinhole | `r` |
/// | radial, `OpenCv` | `r (1 + k1 r² + k2 r⁴)`, and tangential terms |
/// | `FullOpenCv` | `r (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)`, and tangential terms |
/// | fisheye | `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, with the terms that the model has |
/// | `ThinPrismFisheye` | the same, and tangential and prism terms |
/// | `RadTanThinPrismFisheye` | `θ (1 + k0 θ² + … + k5 θ¹²)`, then tangential and prism terms of that position |
/// | `Fov` | `atan(2 r tan(ω/2)) / ω` |
/// | division | `s` with `r = s / (1 + k s²)` |
/// | `Eucm` | `r / (α √(β r² + 1) + 1 − α)` |
///
/// A ray at 90° from the axis or more has no position on the plane, and thus no pixel, for every lens.
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
    /// `fx, fy, cx, cy, k1, k2, k3, k4`
    OpenCvFisheye([f64; 8]),
    /// `fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6`
    FullOpenCv([f64; 12]),
    /// `fx, fy, cx, cy, omega`
    Fov([f64; 5]),
    /// `f, cx, cy, k`
    SimpleRadialFisheye([f64; 4]),
    /// `f, cx, cy, k1, k2`
    RadialFisheye([f64; 5]),
    /// `fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1`
    ThinPrismFisheye([f64; 12]),
    /// `fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3`
    RadTanThinPrismFisheye([f64; 16]),
    /// `f, cx, cy, k`
    SimpleDivision([f64; 4]),
    /// `fx, fy, cx, cy, k`
    Division([f64; 5]),
    /// `f, cx, cy`
    SimpleFisheye([f64; 3]),
    /// `fx, fy, cx, cy`
    Fisheye([f64; 4]),
    /// `fx, fy, cx, cy, alpha, beta`
    Eucm([f64; 6]),
}

/// COLMAP's number, name, and parameters in order.
type Row = (i32, &'static str, &'static str);

const ROWS: [Row; 17] = [
    (0, "SIMPLE_PINHOLE", "f, cx, cy"),
    (1, "PINHOLE", "fx, fy, cx, cy"),
    (2, "SIMPLE_RADIAL", "f, cx, cy, k"),
    (3, "RADIAL", "f, cx, cy, k1, k2"),
    (4, "OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2"),
    (5, "OPENCV_FISHEYE", "fx, fy, cx, cy, k1, k2, k3, k4"),
    (6, "FULL_OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6"),
    (7, "FOV", "fx, fy, cx, cy, omega"),
    (8, "SIMPLE_RADIAL_FISHEYE", "f, cx, cy, k"),
    (9, "RADIAL_FISHEYE", "f, cx, cy, k1, k2"),
    (10, "THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1"),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3"),
    (12, "SIMPLE_DIVISION", "f, cx, cy, k"),
    (13, "DIVISION", "fx, fy, cx, cy, k"),
    (14, "SIMPLE_FISHEYE", "f, cx, cy"),
    (15, "FISHEYE", "fx, fy, cx, cy"),
    (16, "EUCM", "fx, fy, cx, cy, alpha, beta"),
];

/// The parameters of a model in COLMAP's order, from a reference that may be mutable.
macro_rules! params_of {
    ($model:expr) => {
        match $model {
            Self::SimplePinhole(p) | Self::SimpleFisheye(p) => p,
            Self::Pinhole(p)
            | Self::SimpleRadial(p)
            | Self::SimpleRadialFisheye(p)
            | Self::SimpleDivision(p)
            | Self::Fisheye(p) => p,
            Self::Radial(p) | Self::Fov(p) | Self::RadialFisheye(p) | Self::Division(p) => p,
            Self::Eucm(p) => p,
            Self::OpenCv(p) | Self::OpenCvFisheye(p) => p,
            Self::FullOpenCv(p) | Self::ThinPrismFisheye(p) => p,
            Self::RadTanThinPrismFisheye(p) => p,
        }
    };
}

/// COLMAP's number and name of a panorama, which is no camera here.
const PANORAMA: (i32, &str) = (17, "EQUIRECTANGULAR");

/// Maximum field of view of [`CameraModel::Fov`], radians.
const WIDEST_FOV: f64 = std::f64::consts::PI;

impl CameraModel {
    /// Maximum number of parameters of a model.
    pub const MAX_PARAMS: usize = 16;
    /// Names of all models, for messages.
    pub const NAMES: &'static str = "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE, FULL_OPENCV, FOV, \
                                     SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, THIN_PRISM_FISHEYE, \
                                     RAD_TAN_THIN_PRISM_FISHEYE, SIMPLE_DIVISION, DIVISION, SIMPLE_FISHEYE, FISHEYE and \
                                     EUCM";

    /// Builds a model from COLMAP's name, in capitals or not, and parameters.
    ///
    /// # Errors
    /// [`IntrinsicsError`] for an unknown name, a wrong number of parameters, or an invalid value.
    pub fn new(name: &str, params: &[f64]) -> Result<Self, IntrinsicsError> {
        let row = ROWS.iter().find(|row| row.1.eq_ignore_ascii_case(name));
        let Some(&(id, model, order)) = row else {
            if name.eq_ignore_ascii_case(PANORAMA.1) {
                return Err(IntrinsicsError::Panorama);
            }
            return Err(IntrinsicsError::UnknownModel { name: name.to_owned() });
        };
        let made = Self::of(id, params).ok_or_else(|| IntrinsicsError::ParameterCount {
            model,
            order,
            expected: count_of(order),
            actual: params.len(),
        })?;
        if let Some(&value) = params.iter().find(|p| !p.is_finite()) {
            return Err(IntrinsicsError::BadValue { what: "parameter", value });
        }
        if let Some(value) = made.pinhole_parts().0.into_iter().find(|f| *f <= 0.0) {
            return Err(IntrinsicsError::BadValue { what: "focal length", value });
        }
        if let Self::Fov([.., omega]) = made
            && omega.abs() >= WIDEST_FOV
        {
            return Err(IntrinsicsError::BadValue { what: "field of view omega (radians)", value: omega });
        }
        if let Self::Eucm([.., alpha, beta]) = made {
            if !(0.0..=1.0).contains(&alpha) {
                return Err(IntrinsicsError::BadValue { what: "parameter alpha (0 to 1)", value: alpha });
            }
            if beta <= 0.0 {
                return Err(IntrinsicsError::BadValue { what: "parameter beta (above 0)", value: beta });
            }
        }
        Ok(made)
    }

    /// Returns whether a word is the name of a model, in capitals or not.
    pub fn is_name(word: &str) -> bool {
        ROWS.iter().any(|row| row.1.eq_ignore_ascii_case(word))
    }

    fn of(id: i32, params: &[f64]) -> Option<Self> {
        Some(match id {
            0 => Self::SimplePinhole(params.try_into().ok()?),
            1 => Self::Pinhole(params.try_into().ok()?),
            2 => Self::SimpleRadial(params.try_into().ok()?),
            3 => Self::Radial(params.try_into().ok()?),
            4 => Self::OpenCv(params.try_into().ok()?),
            5 => Self::OpenCvFisheye(params.try_into().ok()?),
            6 => Self::FullOpenCv(params.try_into().ok()?),
            7 => Self::Fov(params.try_into().ok()?),
            8 => Self::SimpleRadialFisheye(params.try_into().ok()?),
            9 => Self::RadialFisheye(params.try_into().ok()?),
            10 => Self::ThinPrismFisheye(params.try_into().ok()?),
            11 => Self::RadTanThinPrismFisheye(params.try_into().ok()?),
            12 => Self::SimpleDivision(params.try_into().ok()?),
            13 => Self::Division(params.try_into().ok()?),
            14 => Self::SimpleFisheye(params.try_into().ok()?),
            15 => Self::Fisheye(params.try_into().ok()?),
            16 => Self::Eucm(params.try_into().ok()?),
            _ => return None,
        })
    }

    /// COLMAP's name.
    pub const fn name(&self) -> &'static str {
        ROWS[self.colmap_id() as usize].1
    }

    /// COLMAP's number of the model, as in its binary files.
    pub const fn colmap_id(&self) -> i32 {
        match self {
            Self::SimplePinhole(_) => 0,
            Self::Pinhole(_) => 1,
            Self::SimpleRadial(_) => 2,
            Self::Radial(_) => 3,
            Self::OpenCv(_) => 4,
            Self::OpenCvFisheye(_) => 5,
            Self::FullOpenCv(_) => 6,
            Self::Fov(_) => 7,
            Self::SimpleRadialFisheye(_) => 8,
            Self::RadialFisheye(_) => 9,
            Self::ThinPrismFisheye(_) => 10,
            Self::RadTanThinPrismFisheye(_) => 11,
            Self::SimpleDivision(_) => 12,
            Self::Division(_) => 13,
            Self::SimpleFisheye(_) => 14,
            Self::Fisheye(_) => 15,
            Self::Eucm(_) => 16,
        }
    }

    /// Name and number of parameters of COLMAP's model number; `None` for models not supported here.
    pub fn from_colmap_id(id: i32) -> Option<(&'static str, usize)> {
        ROWS.iter().find(|row| row.0 == id).map(|(_, name, order)| (*name, count_of(order)))
    }

    /// The parameters in COLMAP's order.
    pub const fn params(&self) -> &[f64] {
        params_of!(self)
    }

    const fn params_mut(&mut self) -> &mut [f64] {
        params_of!(self)
    }

    /// Whether both axes share one focal length.
    const fn has_one_focal(&self) -> bool {
        matches!(
            self,
            Self::SimplePinhole(_)
                | Self::SimpleRadial(_)
                | Self::Radial(_)
                | Self::SimpleRadialFisheye(_)
                | Self::RadialFisheye(_)
                | Self::SimpleDivision(_)
                | Self::SimpleFisheye(_)
        )
    }

    /// `([fx, fy], [cx, cy])`
    pub(crate) const fn pinhole_parts(&self) -> ([f64; 2], [f64; 2]) {
        let p = self.params();
        if self.has_one_focal() { ([p[0], p[0]], [p[1], p[2]]) } else { ([p[0], p[1]], [p[2], p[3]]) }
    }

    /// The same camera as a model with a focal length for each axis.
    pub(crate) const fn with_two_focals(self) -> Self {
        match self {
            Self::SimplePinhole([f, cx, cy]) => Self::Pinhole([f, f, cx, cy]),
            Self::SimpleRadial([f, cx, cy, k]) => Self::OpenCv([f, f, cx, cy, k, 0.0, 0.0, 0.0]),
            Self::Radial([f, cx, cy, k1, k2]) => Self::OpenCv([f, f, cx, cy, k1, k2, 0.0, 0.0]),
            Self::SimpleRadialFisheye([f, cx, cy, k]) => {
                Self::OpenCvFisheye([f, f, cx, cy, k, 0.0, 0.0, 0.0])
            }
            Self::RadialFisheye([f, cx, cy, k1, k2]) => Self::OpenCvFisheye([f, f, cx, cy, k1, k2, 0.0, 0.0]),
            Self::SimpleDivision([f, cx, cy, k]) => Self::Division([f, f, cx, cy, k]),
            Self::SimpleFisheye([f, cx, cy]) => Self::Fisheye([f, f, cx, cy]),
            Self::Pinhole(_)
            | Self::OpenCv(_)
            | Self::OpenCvFisheye(_)
            | Self::FullOpenCv(_)
            | Self::Fov(_)
            | Self::ThinPrismFisheye(_)
            | Self::RadTanThinPrismFisheye(_)
            | Self::Division(_)
            | Self::Fisheye(_)
            | Self::Eucm(_) => self,
        }
    }

    /// The distortion of the image turned clockwise by 90°, where `x` is the old `-y` and `y` the old `x`. Focal lengths
    /// and principal point are unchanged.
    pub(crate) const fn with_quarter_turn(mut self) -> Self {
        match &mut self {
            Self::OpenCv([_, _, _, _, _, _, p1, p2]) | Self::FullOpenCv([_, _, _, _, _, _, p1, p2, ..]) => {
                (*p1, *p2) = (*p2, -*p1);
            }
            Self::ThinPrismFisheye([_, _, _, _, _, _, p1, p2, _, _, sx, sy]) => {
                (*p1, *p2) = (*p2, -*p1);
                (*sx, *sy) = (-*sy, *sx);
            }
            Self::RadTanThinPrismFisheye([.., p0, p1, s0, s1, s2, s3]) => {
                (*p0, *p1) = (-*p1, *p0);
                (*s0, *s1, *s2, *s3) = (-*s2, -*s3, *s0, *s1);
            }
            Self::SimplePinhole(_)
            | Self::Pinhole(_)
            | Self::SimpleRadial(_)
            | Self::Radial(_)
            | Self::OpenCvFisheye(_)
            | Self::Fov(_)
            | Self::SimpleRadialFisheye(_)
            | Self::RadialFisheye(_)
            | Self::SimpleDivision(_)
            | Self::Division(_)
            | Self::SimpleFisheye(_)
            | Self::Fisheye(_)
            | Self::Eucm(_) => {}
        }
        self
    }

    /// The same with other focal lengths and another principal point; one focal length becomes the geometric mean.
    pub(crate) fn with_pinhole_parts(mut self, focal: [f64; 2], principal: [f64; 2]) -> Self {
        let one = self.has_one_focal();
        let p = self.params_mut();
        if one {
            p[0] = if focal[0] == focal[1] { focal[0] } else { (focal[0] * focal[1]).sqrt() };
            p[1..3].copy_from_slice(&principal);
        } else {
            p[..2].copy_from_slice(&focal);
            p[2..4].copy_from_slice(&principal);
        }
        self
    }

    /// The distortion of the lens on the plane `z = 1`.
    pub(crate) const fn distortion(&self) -> Distortion {
        match *self {
            Self::SimplePinhole(_) | Self::Pinhole(_) => Distortion::None,
            Self::SimpleRadial([_, _, _, k]) => Distortion::Plane(Planar::of_radial([k])),
            Self::Radial([_, _, _, k1, k2]) => Distortion::Plane(Planar::of_radial([k1, k2])),
            Self::OpenCv([_, _, _, _, k1, k2, p1, p2]) => {
                Distortion::Plane(Planar { tangential: [p1, p2], ..Planar::of_radial([k1, k2]) })
            }
            Self::FullOpenCv([_, _, _, _, k1, k2, p1, p2, k3, k4, k5, k6]) => Distortion::Plane(Planar {
                divisor: [k4, k5, k6],
                tangential: [p1, p2],
                ..Planar::of_radial([k1, k2, k3])
            }),
            Self::SimpleFisheye(_) | Self::Fisheye(_) => Distortion::Fisheye(Planar::NONE),
            Self::SimpleRadialFisheye([_, _, _, k]) => Distortion::Fisheye(Planar::of_radial([k])),
            Self::RadialFisheye([_, _, _, k1, k2]) => Distortion::Fisheye(Planar::of_radial([k1, k2])),
            Self::OpenCvFisheye([_, _, _, _, k1, k2, k3, k4]) => {
                Distortion::Fisheye(Planar::of_radial([k1, k2, k3, k4]))
            }
            Self::ThinPrismFisheye([_, _, _, _, k1, k2, p1, p2, k3, k4, sx, sy]) => {
                Distortion::Fisheye(Planar {
                    tangential: [p1, p2],
                    prism: [[sx, 0.0], [sy, 0.0]],
                    ..Planar::of_radial([k1, k2, k3, k4])
                })
            }
            Self::RadTanThinPrismFisheye([_, _, _, _, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3]) => {
                // `p0` and `p1` are OpenCV's `p2` and `p1`.
                let rest = Planar { tangential: [p1, p0], prism: [[s0, s1], [s2, s3]], ..Planar::NONE };
                Distortion::FisheyeInTwoSteps(Planar::of_radial([k0, k1, k2, k3, k4, k5]), rest)
            }
            Self::Fov([_, _, _, _, omega]) => Distortion::Fov(omega),
            Self::SimpleDivision([_, _, _, k]) | Self::Division([_, _, _, _, k]) => Distortion::Division(k),
            Self::Eucm([_, _, _, _, alpha, beta]) => Distortion::Eucm(alpha, beta),
        }
    }

    /// The error for COLMAP's number of a model that is not supported here.
    pub fn unsupported(id: i32) -> IntrinsicsError {
        if id == PANORAMA.0 {
            return IntrinsicsError::Panorama;
        }
        IntrinsicsError::UnknownModel { name: id.to_string() }
    }
}

fn count_of(order: &str) -> usize {
    order.split(',').count()
}
