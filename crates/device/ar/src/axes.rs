//! Axes and units of AR frameworks.
//!
//! | | world | camera | units |
//! |---|---|---|---|
//! | `OpenGl`: ARKit, ARCore, WebXR, OpenXR | `x` right, `y` up, `z` back | `x` right, `y` up, looks along `-z` | metres |
//! | `Unity` | `x` right, `y` up, `z` forward, left-handed | the same, looks along `z` | metres |
//! | `Unreal` | `x` forward, `y` right, `z` up, left-handed | the same, looks along `x` | centimetres |
//! | `Colmap` | that of `OpenGl`, or of the map | `x` right, `y` down, looks along `z` | metres |
//!
//! One right-handed world becomes the others by an exchange of axes `W` and a factor `s`, and a camera with COLMAP's
//! axes by `K`. With the world of `OpenGl` as the first:
//!
//! ```text
//!            OpenGl              Unity              Unreal              Colmap
//! W          (x, y, z)           (x, y, -z)         (-z, x, y)          (x, y, z)
//! K          (x, -y, -z)         (x, -y, z)         (z, x, -y)          (x, y, z)
//! s          1                   1                  100                 1
//!
//! R' = W R Kᵀ,  t' = s W t       of a camera with pose (R, t) in the world
//! R' = W R Wᵀ,  t' = s W t       of content: its own axes change with those of the world
//! ```
//!
//! `W` of Unity and Unreal are those of AR Foundation and of Unreal's plugins for ARKit and ARCore.

use std::fmt;
use std::str::FromStr;

use veiloc_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use veiloc_geometry::{Rigid3, frames::Camera};
use veiloc_protocol::AnswerPose;

/// The world of the AR framework: `x` right, `y` up, `z` back at the start of the AR session, metres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArWorld {}

/// The pose of the camera in the AR world, `x_cam = R x_ar + t`, metres; the camera has COLMAP's axes (`x` right, `y`
/// down, `z` forward).
pub type CameraFromAr = Rigid3<Camera, ArWorld>;

/// A pose as a framework states it: where an object is in the world, and how it is turned there, in the framework's
/// axes and units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameworkPose {
    /// Position in the world.
    pub position: [f64; 3],
    /// Rotation from the object's axes to the world's, a quaternion `x y z w` of any length, as all frameworks order it.
    pub rotation: [f64; 4],
}

impl Default for FrameworkPose {
    /// At the origin, not turned.
    fn default() -> Self {
        Self { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl FrameworkPose {
    /// From the columns of a 4 × 4 matrix, as ARKit, ARCore, WebXR and OpenGL store it: elements 12 to 14 are the
    /// position. `None` when it is not a rigid transform.
    pub fn from_matrix(columns: &[f64; 16]) -> Option<Self> {
        let rotation = Matrix3::from_fn(|row, column| columns[4 * column + row]);
        let position = [columns[12], columns[13], columns[14]];
        let last_row = [columns[3], columns[7], columns[11], columns[15]];
        let pose = Rigid3::<ArWorld, ArWorld>::from_matrix(rotation, position.into())?;
        (last_row == [0.0, 0.0, 0.0, 1.0]).then(|| Self::of(pose.rotation(), pose.translation()))
    }

    /// The pose in the world of what has the pose `mounted` in the axes of this object: of the camera of a headset, from
    /// the pose of the head and the lens offset that the framework states. Both in the same axes and units, also
    /// left-handed ones. `None` when a rotation is zero, or a number is not finite.
    pub fn composed(&self, mounted: &Self) -> Option<Self> {
        let parts = |pose: &Self| {
            let (rotation, position) = pose.parts()?;
            Some(Rigid3::<ArWorld, ArWorld>::new(Rotation3::from_matrix_unchecked(rotation), position))
        };
        let composed = parts(self)?.compose(&parts(mounted)?);
        Some(Self::of(composed.rotation(), composed.translation()))
    }

    fn of(rotation: &Rotation3<f64>, position: &Vector3<f64>) -> Self {
        let q = UnitQuaternion::from_rotation_matrix(rotation);
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        Self { position: (*position).into(), rotation: [q.i, q.j, q.k, q.w].map(|c| sign * c) }
    }

    /// Rotation and position; `None` when the rotation is zero, or a number is not finite.
    fn parts(&self) -> Option<(Matrix3<f64>, Vector3<f64>)> {
        let [x, y, z, w] = self.rotation;
        let pose = Rigid3::<ArWorld, ArWorld>::from_quaternion([w, x, y, z], self.position)?;
        Some((*pose.rotation().matrix(), *pose.translation()))
    }
}

/// The axes and units of a framework.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Axes {
    /// ARKit, ARCore, WebXR, OpenXR, glTF.
    #[default]
    OpenGl,
    /// Unity, AR Foundation included.
    Unity,
    /// Unreal Engine, centimetres.
    Unreal,
    /// Cameras as in COLMAP and OpenCV. COLMAP's worlds have no fixed axes, so the world's are not changed; gravity is
    /// along `-y` as for the others.
    Colmap,
}

/// A word that names no axes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown axes {0:?}; known: opengl (also arkit, arcore, webxr, openxr), unity, unreal, colmap (also opencv)"
)]
pub struct AxesError(String);

impl Axes {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::OpenGl, Self::Unity, Self::Unreal, Self::Colmap];

    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OpenGl => "opengl",
            Self::Unity => "unity",
            Self::Unreal => "unreal",
            Self::Colmap => "colmap",
        }
    }

    /// Units of the framework per metre.
    pub const fn units_per_metre(self) -> f64 {
        match self {
            Self::Unreal => 100.0,
            Self::OpenGl | Self::Unity | Self::Colmap => 1.0,
        }
    }

    /// `W`: from the axes of the AR world to those of the framework's world.
    #[rustfmt::skip]
    fn world(self) -> Matrix3<f64> {
        match self {
            Self::OpenGl | Self::Colmap => Matrix3::identity(),
            Self::Unity => Matrix3::new(1.0, 0.0, 0.0,  0.0, 1.0, 0.0,  0.0, 0.0, -1.0),
            Self::Unreal => Matrix3::new(0.0, 0.0, -1.0,  1.0, 0.0, 0.0,  0.0, 1.0, 0.0),
        }
    }

    /// `K`: from COLMAP's axes of a camera to those of the framework's camera.
    #[rustfmt::skip]
    fn camera(self) -> Matrix3<f64> {
        match self {
            Self::OpenGl => Matrix3::new(1.0, 0.0, 0.0,  0.0, -1.0, 0.0,  0.0, 0.0, -1.0),
            Self::Unity => Matrix3::new(1.0, 0.0, 0.0,  0.0, -1.0, 0.0,  0.0, 0.0, 1.0),
            Self::Unreal => Matrix3::new(0.0, 0.0, 1.0,  1.0, 0.0, 0.0,  0.0, -1.0, 0.0),
            Self::Colmap => Matrix3::identity(),
        }
    }

    /// The pose of a camera, from the framework's. `None` when the rotation is zero, or a number is not finite.
    ///
    /// It is the camera of the image that is sealed. ARKit's `ARCamera.transform` and ARCore's `Camera.getPose()` are
    /// those of the image as the sensor gives it; ARCore's `getDisplayOrientedPose()` and the camera of AR Foundation
    /// are those of the image turned upright ([`CameraFrame::turned`](crate::CameraFrame::turned)).
    pub fn cam_from_ar(self, pose: &FrameworkPose) -> Option<CameraFromAr> {
        let (rotation, position) = pose.parts()?;
        let world = self.world().transpose();
        let rotation = Rotation3::from_matrix_unchecked(world * rotation * self.camera());
        let position = world * position / self.units_per_metre();
        Some(Rigid3::<ArWorld, Camera>::new(rotation, position).inverse())
    }

    /// The inverse of [`Self::cam_from_ar`].
    pub fn camera_pose(self, cam_from_ar: &CameraFromAr) -> FrameworkPose {
        let ar_from_cam = cam_from_ar.inverse();
        self.placed(&ar_from_cam, &self.camera())
    }

    /// The pose of content in the framework's world. Its own axes change as those of the world do: what points along
    /// `z` of the AR world in `ar_from_object` points along Unity's `-z`.
    pub fn object_pose<Object>(self, ar_from_object: &Rigid3<ArWorld, Object>) -> FrameworkPose {
        self.placed(ar_from_object, &self.world())
    }

    /// The inverse of [`Self::object_pose`]; `None` when the rotation is zero, or a number is not finite.
    pub fn ar_from_object<Object>(self, pose: &FrameworkPose) -> Option<Rigid3<ArWorld, Object>> {
        let (rotation, position) = pose.parts()?;
        let world = self.world();
        let rotation = Rotation3::from_matrix_unchecked(world.transpose() * rotation * world);
        Some(Rigid3::new(rotation, world.transpose() * position / self.units_per_metre()))
    }

    /// Where the answer's camera is in the map, in the framework's axes: the map's axes take the place of the AR
    /// world's. For apps that draw the map itself; [`Alignment`](crate::Alignment) is for content in the AR world.
    ///
    /// `metres_per_unit`: of the map. `None` when the rotation is zero, or a number is not finite.
    pub fn camera_in_map(self, pose: &AnswerPose, metres_per_unit: f64) -> Option<FrameworkPose> {
        let translation = pose.translation.map(|t| t * metres_per_unit);
        let cam_from_map = CameraFromAr::from_quaternion(pose.rotation, translation)?;
        Some(self.camera_pose(&cam_from_map))
    }

    /// `R' = W R Oᵀ`, `t' = s W t`.
    fn placed<Object>(self, pose: &Rigid3<ArWorld, Object>, object: &Matrix3<f64>) -> FrameworkPose {
        let rotation = self.world() * pose.rotation().matrix() * object.transpose();
        let position = self.world() * pose.translation() * self.units_per_metre();
        FrameworkPose::of(&Rotation3::from_matrix_unchecked(rotation), &position)
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Axes {
    type Err = AxesError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.trim().to_ascii_lowercase().as_str() {
            "opengl" | "arkit" | "arcore" | "webxr" | "openxr" => Ok(Self::OpenGl),
            "unity" => Ok(Self::Unity),
            "unreal" => Ok(Self::Unreal),
            "colmap" | "opencv" => Ok(Self::Colmap),
            _ => Err(AxesError(text.chars().take(40).collect())),
        }
    }
}
