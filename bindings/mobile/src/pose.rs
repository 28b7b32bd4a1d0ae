//! Poses in the axes of AR frameworks.

use veiloc_ar::{CameraFromAr, FrameworkPose};

use crate::error::VeilocException;

/// Axes and units of a framework.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum Axes {
    /// ARKit, ARCore, WebXR, OpenXR: y up, looks along -z, metres.
    OpenGl,
    /// Unity: left-handed, y up, looks along z, metres.
    Unity,
    /// Unreal: left-handed, z up, looks along x, centimetres.
    Unreal,
    /// Cameras as in COLMAP and OpenCV: y down, look along z; the world is that of `OpenGl`, or of the map. Metres.
    Colmap,
}

/// A pose as a framework states it: position in the world, and quaternion from the object's axes to the world's.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct Pose {
    /// Position.
    pub x: f64,
    /// Position.
    pub y: f64,
    /// Position.
    pub z: f64,
    /// Quaternion.
    pub qx: f64,
    /// Quaternion.
    pub qy: f64,
    /// Quaternion.
    pub qz: f64,
    /// Quaternion, real part.
    pub qw: f64,
}

/// The pose of the camera in the AR world when it took a frame.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct CameraPose {
    /// In these axes.
    pub axes: Axes,
    /// The pose. In axes whose vertical is gravity, as in ARKit and ARCore.
    pub pose: Pose,
}

/// Radii of 68 % confidence, as ARCore states them.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct Accuracy {
    /// Radius on the ground, metres.
    pub horizontal: f64,
    /// Up and down, metres.
    pub vertical: f64,
    /// Rotation about the vertical, degrees.
    pub yaw_deg: f64,
}

impl From<Axes> for veiloc_ar::Axes {
    fn from(axes: Axes) -> Self {
        match axes {
            Axes::OpenGl => Self::OpenGl,
            Axes::Unity => Self::Unity,
            Axes::Unreal => Self::Unreal,
            Axes::Colmap => Self::Colmap,
        }
    }
}

impl From<FrameworkPose> for Pose {
    fn from(pose: FrameworkPose) -> Self {
        let ([x, y, z], [qx, qy, qz, qw]) = (pose.position, pose.rotation);
        Self { x, y, z, qx, qy, qz, qw }
    }
}

impl From<Pose> for FrameworkPose {
    fn from(Pose { x, y, z, qx, qy, qz, qw }: Pose) -> Self {
        Self { position: [x, y, z], rotation: [qx, qy, qz, qw] }
    }
}

impl From<veiloc_ar::Accuracy> for Accuracy {
    fn from(veiloc_ar::Accuracy { horizontal, vertical, yaw_deg }: veiloc_ar::Accuracy) -> Self {
        Self { horizontal, vertical, yaw_deg }
    }
}

impl CameraPose {
    pub(crate) fn cam_from_ar(self) -> Result<CameraFromAr, VeilocException> {
        veiloc_ar::Axes::from(self.axes).cam_from_ar(&self.pose.into()).ok_or_else(no_pose)
    }
}

pub(crate) fn no_pose() -> VeilocException {
    VeilocException::argument("the pose has a rotation of zero, or a number that is not finite")
}

/// The pose of what is mounted on an object, such as the camera of a headset on the head: the pose of the object in the
/// world, and that of the mounted one in the object's axes (the lens offset). Both in the same axes and units.
///
/// # Errors
/// [`VeilocException::Argument`] for a pose that is no rotation.
#[uniffi::export]
pub fn composed_pose(object: Pose, mounted: Pose) -> Result<Pose, VeilocException> {
    let composed = FrameworkPose::from(object).composed(&mounted.into());
    Ok(composed.ok_or_else(no_pose)?.into())
}

/// A pose from the columns of a 4 × 4 matrix, 16 numbers: `simd_float4x4` of ARKit, `Pose.toMatrix` of ARCore.
///
/// # Errors
/// [`VeilocException::Argument`] when it is not a rigid transform.
#[uniffi::export]
pub fn pose_from_matrix(columns: Vec<f32>) -> Result<Pose, VeilocException> {
    let columns: Option<[f32; 16]> = columns.try_into().ok();
    let pose = columns.and_then(|columns| FrameworkPose::from_matrix(&columns.map(f64::from)));
    let pose = pose.ok_or_else(|| VeilocException::argument("not the columns of a rigid transform"))?;
    Ok(pose.into())
}
