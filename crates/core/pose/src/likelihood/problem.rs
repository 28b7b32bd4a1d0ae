//! The input of pose estimation: correspondences between one query and the map.

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, Pencils, Pinhole, Pixel, PixelLine, Point3};

use crate::error::PoseError;
use crate::likelihood::map_cameras::MapCameras;

/// The observation of each correspondence, `[N]`.
#[derive(Debug, Clone, PartialEq)]
pub enum Correspondences {
    /// The keypoints themselves.
    Points {
        /// `[N]`, undistorted.
        pixels: Vec<Pixel>,
    },
    /// Lines through the keypoints, of any direction.
    Lines {
        /// `[N]`, in undistorted pixels.
        lines: Vec<PixelLine>,
    },
    /// Dual Convergent Lines: half-planes about one of the anchors.
    Anchored {
        /// The anchors and sectors.
        pencils: Pencils,
        /// `[N]`, anchor and angle as [`Pencils::angle_of`] measures it.
        lines: Vec<(Anchor, f64)>,
    },
}

impl Correspondences {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Points { pixels } => pixels.len(),
            Self::Lines { lines } => lines.len(),
            Self::Anchored { lines, .. } => lines.len(),
        }
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Correspondences in a minimal sample: three points or six lines.
    pub const fn sample_size(&self) -> usize {
        match self {
            Self::Points { .. } => 3,
            Self::Lines { .. } | Self::Anchored { .. } => 6,
        }
    }

    /// Those with these indices.
    pub(crate) fn subset(&self, kept: &[usize]) -> Self {
        match self {
            Self::Points { pixels } => Self::Points { pixels: chosen(pixels, kept) },
            Self::Lines { lines } => Self::Lines { lines: chosen(lines, kept) },
            Self::Anchored { pencils, lines } => {
                Self::Anchored { pencils: pencils.clone(), lines: chosen(lines, kept) }
            }
        }
    }

    /// Residuals of one correspondence: two for points, one for lines.
    pub(crate) const fn residuals(&self) -> usize {
        match self {
            Self::Points { .. } => 2,
            Self::Lines { .. } | Self::Anchored { .. } => 1,
        }
    }
}

/// A query's correspondences and the camera that saw them.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseProblem {
    /// The camera of the observations, without distortion.
    pub camera: Pinhole,
    /// What was seen, `[N]`.
    pub observations: Correspondences,
    /// The keypoint of each correspondence, `[N]`: its row in the query, or any other number that is equal for
    /// correspondences of one keypoint and different otherwise.
    ///
    /// A keypoint proposed for several map points has one correspondence per map point, and one that was sent as two
    /// lines one per line: at most one of them is right, and they count as one piece of evidence. The observations do
    /// not identify keypoints, because different keypoints often have the same line after angles are rounded.
    pub keypoints: Vec<usize>,
    /// The map points proposed for them, `[N]`, map units.
    pub points: Vec<Point3<World>>,
    /// Probability in (0, 1) that each correspondence is right, `[N]`; `None` treats all alike.
    ///
    /// Used as sampling weight under both scores, and in the likelihood. See `veiloc_descriptor::MatchPrior`.
    pub prior: Option<Vec<f64>>,
    /// From where each correspondence's descriptor was seen when the map was made, `[N]`: a pose from which the point
    /// looks different does not explain the match. `None` lets every pose see every point.
    pub seen_from: Option<Vec<MatchViewpoint>>,
    /// The gravity direction, if the device measured it: then smaller samples are enough.
    pub gravity: Option<Gravity>,
    /// Approximate camera position, if known.
    pub position: Option<PositionPrior>,
    /// How well the focal length of [`Self::camera`] is known.
    pub focal: FocalPrior,
    /// Covariance of each map point in the world frame, `[N]`, map units squared; `None` treats the map as exact.
    pub point_covariances: Option<Vec<[[f64; 3]; 3]>>,
    /// Errors of the map's cameras.
    pub map_cameras: MapCameras,
}

/// The map image that proposed a match.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchViewpoint {
    /// Its camera centre, world frame, map units.
    pub center: Point3<World>,
    /// Its focal length, pixels.
    pub focal_px: f64,
}

/// One world direction measured by the camera: down, by an accelerometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gravity {
    /// In the camera frame; any length but zero.
    pub in_camera: Vector3<f64>,
    /// The same direction in the world frame; any length but zero.
    pub in_world: Vector3<f64>,
    /// Standard deviation about each of the two axes across it, degrees; above 0.
    pub sd_deg: f64,
}

impl Gravity {
    /// Default for a phone's accelerometer, degrees.
    pub const PHONE_SD_DEG: f64 = 2.0;

    /// As measured by a phone at rest ([`Self::PHONE_SD_DEG`]).
    pub const fn from_accelerometer(in_camera: Vector3<f64>, in_world: Vector3<f64>) -> Self {
        Self { in_camera, in_world, sd_deg: Self::PHONE_SD_DEG }
    }
}

/// Prior of the camera position, for example from GPS: a normal distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionPrior {
    /// Mean, world frame, map units.
    pub center: Point3<World>,
    /// Standard deviation along each axis, map units; above 0.
    pub sd: f64,
}

/// How well a camera's focal length is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FocalPrior {
    /// Measured for this camera.
    #[default]
    Calibrated,
    /// From the image's metadata: usually correct to some per cent, and wrong when the image was cropped.
    Exif,
    /// A default value.
    Unknown,
}

impl PoseProblem {
    /// A problem with one entry per correspondence in all three lists, `[N]`; no priors, and a calibrated camera.
    pub const fn new(
        camera: Pinhole,
        observations: Correspondences,
        keypoints: Vec<usize>,
        points: Vec<Point3<World>>,
    ) -> Self {
        Self {
            camera,
            observations,
            keypoints,
            points,
            prior: None,
            seen_from: None,
            gravity: None,
            position: None,
            focal: FocalPrior::Calibrated,
            point_covariances: None,
            map_cameras: MapCameras::UNMEASURED,
        }
    }

    /// The problem with only the correspondences of these indices.
    pub(crate) fn subset(&self, kept: &[usize]) -> Self {
        Self {
            camera: self.camera,
            observations: self.observations.subset(kept),
            keypoints: chosen(&self.keypoints, kept),
            points: chosen(&self.points, kept),
            prior: self.prior.as_ref().map(|of| chosen(of, kept)),
            seen_from: self.seen_from.as_ref().map(|of| chosen(of, kept)),
            gravity: self.gravity,
            position: self.position,
            focal: self.focal,
            point_covariances: self.point_covariances.as_ref().map(|of| chosen(of, kept)),
            map_cameras: self.map_cameras,
        }
    }

    /// Rejects problems from which no pose can be estimated. All other functions of this crate require a checked
    /// problem.
    ///
    /// # Errors
    /// [`PoseError`]: lists that differ in length, a number that is not finite or not allowed, or fewer correspondences
    /// than a minimal sample.
    pub fn check(&self) -> Result<(), PoseError> {
        let n = self.observations.len();
        let required = self.observations.sample_size();
        for (what, actual) in [("points", self.points.len()), ("keypoints", self.keypoints.len())] {
            if actual != n {
                return Err(PoseError::LengthMismatch { what, expected: n, actual });
            }
        }
        let c = &self.camera;
        positive("focal length fx", c.focal[0])?;
        positive("focal length fy", c.focal[1])?;
        for (what, value) in [("principal point cx", c.principal[0]), ("principal point cy", c.principal[1])]
        {
            if !value.is_finite() {
                return Err(PoseError::BadValue { what, value });
            }
        }
        if c.width == 0 || c.height == 0 {
            return Err(PoseError::BadValue { what: "image size", value: 0.0 });
        }
        let bad = match &self.observations {
            Correspondences::Points { pixels } => pixels.iter().position(|p| !p.is_finite()),
            Correspondences::Lines { lines } => {
                lines.iter().position(|l| !l.coefficients().iter().all(|c| c.is_finite()))
            }
            Correspondences::Anchored { pencils, lines } => {
                let is_line = |anchor: Anchor, angle: f64| {
                    anchor.index() < pencils.len()
                        && angle.is_finite()
                        && pencils.line(anchor, angle).is_some()
                };
                lines.iter().position(|(anchor, angle)| !is_line(*anchor, *angle))
            }
        };
        if let Some(index) = bad {
            return Err(PoseError::NotFinite { what: "observation", index });
        }
        if let Some(index) = self.points.iter().position(|p| !p.is_finite()) {
            return Err(PoseError::NotFinite { what: "point", index });
        }
        if let Some(prior) = &self.prior {
            if prior.len() != n {
                return Err(PoseError::LengthMismatch { what: "prior", expected: n, actual: prior.len() });
            }
            if let Some(index) = prior.iter().position(|p| !(0.0..=1.0).contains(p)) {
                return Err(PoseError::BadPrior { index, value: prior[index] });
            }
        }
        if let Some(seen_from) = &self.seen_from {
            if seen_from.len() != n {
                let actual = seen_from.len();
                return Err(PoseError::LengthMismatch { what: "seen_from", expected: n, actual });
            }
            let possible =
                |s: &MatchViewpoint| s.center.is_finite() && s.focal_px.is_finite() && s.focal_px > 0.0;
            if let Some(index) = seen_from.iter().position(|s| !possible(s)) {
                return Err(PoseError::NotFinite { what: "seen_from", index });
            }
        }
        if let Some(gravity) = &self.gravity {
            for (what, v) in [
                ("length of gravity in the camera", gravity.in_camera),
                ("length of gravity in the world", gravity.in_world),
            ] {
                if !(v.norm().is_finite() && v.norm() > 0.0) {
                    return Err(PoseError::BadValue { what, value: v.norm() });
                }
            }
            positive("standard deviation of gravity", gravity.sd_deg)?;
        }
        if let Some(position) = &self.position {
            if !position.center.is_finite() {
                return Err(PoseError::NotFinite { what: "position prior", index: 0 });
            }
            positive("standard deviation of the position prior", position.sd)?;
        }
        if let Some(covariances) = &self.point_covariances {
            if covariances.len() != n {
                let actual = covariances.len();
                return Err(PoseError::LengthMismatch { what: "point covariances", expected: n, actual });
            }
            let possible = |c: &[[f64; 3]; 3]| {
                c.iter().flatten().all(|v| v.is_finite()) && (0..3).all(|k| c[k][k] >= 0.0)
            };
            if let Some(index) = covariances.iter().position(|c| !possible(c)) {
                return Err(PoseError::NotFinite { what: "point covariance", index });
            }
        }
        for sd in self.map_cameras.sd {
            positive("error of the map's cameras", sd)?;
        }
        if n < required {
            return Err(PoseError::TooFew { required, actual: n });
        }
        Ok(())
    }
}

fn chosen<T: Clone>(of: &[T], kept: &[usize]) -> Vec<T> {
    kept.iter().map(|&i| of[i].clone()).collect()
}

/// Rejects a number that is not finite or not above 0.
fn positive(what: &'static str, value: f64) -> Result<(), PoseError> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { Err(PoseError::BadValue { what, value }) }
}
