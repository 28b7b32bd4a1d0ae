//! Poses in the axes of AR frameworks.

use veiloc_ar::{Accuracy, Axes, CameraFromAr, FrameworkPose};

use crate::pointers;
use crate::status::{Failure, VeilocStatus, guarded};

/// Axes and units of a framework.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocAxes {
    /// ARKit, ARCore, WebXR, OpenXR: y up, looks along -z, metres.
    OpenGl = 0,
    /// Unity: left-handed, y up, looks along z, metres.
    Unity = 1,
    /// Unreal: left-handed, z up, looks along x, centimetres.
    Unreal = 2,
    /// Cameras as in COLMAP and OpenCV: y down, look along z; the world is that of OpenGl, or of the map. Metres.
    Colmap = 3,
}

/// A pose as a framework states it: where an object is in the world, and how it is turned there.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocPose {
    /// Position in the world.
    pub position: [f64; 3],
    /// Quaternion x, y, z, w: from the object's axes to the world's.
    pub rotation: [f64; 4],
}

/// Radii of 68 % confidence, as ARCore states them.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocAccuracy {
    /// Radius on the ground, metres.
    pub horizontal: f64,
    /// Up and down, metres.
    pub vertical: f64,
    /// Rotation about the vertical, degrees.
    pub yaw_deg: f64,
}

impl From<Accuracy> for VeilocAccuracy {
    fn from(Accuracy { horizontal, vertical, yaw_deg }: Accuracy) -> Self {
        Self { horizontal, vertical, yaw_deg }
    }
}

impl From<FrameworkPose> for VeilocPose {
    fn from(FrameworkPose { position, rotation }: FrameworkPose) -> Self {
        Self { position, rotation }
    }
}

impl VeilocPose {
    pub(crate) const fn framework(&self) -> FrameworkPose {
        FrameworkPose { position: self.position, rotation: self.rotation }
    }

    pub(crate) fn cam_from_ar(&self, axes: Axes) -> Result<CameraFromAr, Failure> {
        axes.cam_from_ar(&self.framework()).ok_or_else(no_pose)
    }
}

pub(crate) fn no_pose() -> Failure {
    Failure::new(VeilocStatus::Argument, "the pose has a rotation of zero, or a number that is not finite")
}

/// The axes of a number, as C passes it.
pub(crate) fn axes(number: u32) -> Result<Axes, Failure> {
    match number {
        0 => Ok(Axes::OpenGl),
        1 => Ok(Axes::Unity),
        2 => Ok(Axes::Unreal),
        3 => Ok(Axes::Colmap),
        _ => Err(Failure::new(VeilocStatus::Argument, format!("there are no axes {number}"))),
    }
}

/// A pose from the columns of a 4 x 4 matrix: `simd_float4x4` of ARKit, `Pose.toMatrix` of ARCore, WebXR's `matrix`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pose_from_matrix(columns: *const f64, out: *mut VeilocPose) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; `columns` points to 16 numbers.
        let columns = unsafe { pointers::slice(columns, 16, "columns") }?;
        let columns = columns.try_into().map_err(|_| no_pose())?;
        let pose = FrameworkPose::from_matrix(columns)
            .ok_or_else(|| Failure::new(VeilocStatus::Argument, "the matrix is not a rigid transform"))?;
        // SAFETY: as above.
        unsafe { pointers::give(out, pose.into(), "out") }
    })
}

/// The pose of what is mounted on an object, such as the camera of a headset on the head: the pose of the object in the
/// world, and that of the mounted one in the object's axes (the lens offset). Both in the same axes and units.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pose_composed(
    object: *const VeilocPose,
    mounted: *const VeilocPose,
    out: *mut VeilocPose,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let object = unsafe { pointers::reference(object, "object") }?.framework();
        // SAFETY: as above.
        let mounted = unsafe { pointers::reference(mounted, "mounted") }?.framework();
        let composed = object.composed(&mounted).ok_or_else(no_pose)?;
        // SAFETY: as above.
        unsafe { pointers::give(out, composed.into(), "out") }
    })
}
