//! The transform from the map to the AR world.

use veiloc_ar::{Alignment, AlignmentOptions, AlignmentState, DistanceVerdict, Update, check_unit};

use crate::answer::VeilocAnswer;
use crate::pointers;
use crate::pose::{VeilocAccuracy, VeilocPose, axes, no_pose};
use crate::status::{Failure, VeilocStatus, guarded};

/// Answers of one AR session, and the transform that most of them agree on.
pub struct VeilocAlignment {
    pub(crate) alignment: Alignment,
}

/// How far the transform is known.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum VeilocAlignmentState {
    /// No trusted answer came yet.
    #[default]
    Searching = 0,
    /// One answer: content may be shown, and may move.
    Tentative = 1,
    /// At least two answers agree.
    Aligned = 2,
}

/// What an answer did.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocUpdate {
    /// It is part of the transform.
    Used = 0,
    /// It is trusted but contradicts the transform, which did not move.
    Contradicts = 1,
    /// It is doubtful and agrees. Nothing changed.
    DoubtfulAgrees = 2,
    /// It is doubtful and contradicts, or there is no transform. Nothing changed.
    Doubtful = 3,
    /// It has no pose, or one with a free direction. Nothing changed.
    NoPose = 4,
    /// It does not state the unit of the map, and `veiloc_alignment_new` got none. Nothing changed.
    UnknownUnit = 5,
}

/// What distances between answers say, compared with the AR framework's.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum VeilocDistances {
    /// Too few answers, or too near to each other.
    #[default]
    Unknown = 0,
    /// They agree within 5 %.
    Agree = 1,
    /// They differ: check the unit of the map and the focal length.
    Differ = 2,
}

/// The numbers of an alignment.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocAlignmentInfo {
    /// How far the transform is known.
    pub state: VeilocAlignmentState,
    /// Answers that it is the average of.
    pub used: u32,
    /// Trusted answers that contradict it.
    pub contradicting: u32,
    /// What distances between answers say.
    pub distances: VeilocDistances,
    /// Distances in the map divided by those of the AR framework; 0 while there are none.
    pub distance_ratio: f64,
}

/// Begins an alignment. `metres_per_unit`: of the map; 0 for the unit that the answers state.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_new(
    metres_per_unit: f64,
    out: *mut *mut VeilocAlignment,
) -> VeilocStatus {
    guarded(|| {
        let mut options = AlignmentOptions::default();
        if metres_per_unit != 0.0 {
            let metres = check_unit(metres_per_unit).map_err(|e| Failure::new(VeilocStatus::Argument, e))?;
            options = options.with_metres_per_unit(metres);
        }
        let alignment = VeilocAlignment { alignment: Alignment::new(options) };
        // SAFETY: the contract of the crate.
        unsafe { pointers::give_handle(out, alignment) }
    })
}

/// Takes an answer and the pose of the camera **when it took the frame that was sealed**, not its pose now.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_add(
    alignment: *mut VeilocAlignment,
    answer: *const VeilocAnswer,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    out: *mut VeilocUpdate,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let alignment = unsafe { pointers::mutable(alignment, "alignment") }?;
        // SAFETY: as above.
        let answer = &unsafe { pointers::reference(answer, "answer") }?.answer;
        // SAFETY: as above.
        let camera = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        let camera = camera.cam_from_ar(axes(pose_axes)?)?;
        let update = match alignment.alignment.add(answer, &camera) {
            Update::Used => VeilocUpdate::Used,
            Update::Contradicts => VeilocUpdate::Contradicts,
            Update::DoubtfulAgrees => VeilocUpdate::DoubtfulAgrees,
            Update::Doubtful => VeilocUpdate::Doubtful,
            Update::NoPose => VeilocUpdate::NoPose,
            Update::UnknownUnit => VeilocUpdate::UnknownUnit,
        };
        // SAFETY: as above.
        unsafe { pointers::give(out, update, "out") }
    })
}

/// The numbers of an alignment; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_info(alignment: *const VeilocAlignment) -> VeilocAlignmentInfo {
    let mut info = VeilocAlignmentInfo::default();
    // SAFETY: the contract of the crate.
    let Some(VeilocAlignment { alignment, .. }) = (unsafe { pointers::optional(alignment) }) else {
        return info;
    };
    info.state = match alignment.state() {
        AlignmentState::Searching => VeilocAlignmentState::Searching,
        AlignmentState::Tentative => VeilocAlignmentState::Tentative,
        AlignmentState::Aligned => VeilocAlignmentState::Aligned,
    };
    if let Some(aligned) = alignment.aligned() {
        (info.used, info.contradicting) = (aligned.used as u32, aligned.contradicting as u32);
    }
    if let Some(ratio) = alignment.distance_ratio() {
        info.distance_ratio = ratio.median;
        info.distances = match ratio.verdict() {
            DistanceVerdict::Unknown => VeilocDistances::Unknown,
            DistanceVerdict::Agrees => VeilocDistances::Agree,
            DistanceVerdict::Differs => VeilocDistances::Differ,
        };
    }
    info
}

/// The pose in the AR world of content whose pose in the map is known (map units, x y z w). `NotAligned` before the
/// first trusted answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_world_from_anchor(
    alignment: *const VeilocAlignment,
    pose_axes: u32,
    map_from_anchor: *const VeilocPose,
    out: *mut VeilocPose,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let alignment = &unsafe { pointers::reference(alignment, "alignment") }?.alignment;
        // SAFETY: as above.
        let anchor = unsafe { pointers::reference(map_from_anchor, "map_from_anchor") }?.framework();
        let axes = axes(pose_axes)?;
        if alignment.aligned().is_none() {
            return Err(not_aligned());
        }
        let pose = alignment.world_from_anchor(axes, &anchor).ok_or_else(no_pose)?;
        // SAFETY: as above.
        unsafe { pointers::give(out, pose.into(), "out") }
    })
}

/// Where the camera is in the map now, by its pose in the AR world: position in map units, and the rotation from the
/// camera's axes (COLMAP's: x right, y down, z forward) to the map's. `accuracy` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_camera_in_map(
    alignment: *const VeilocAlignment,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    out: *mut VeilocPose,
    accuracy: *mut VeilocAccuracy,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let alignment = &unsafe { pointers::reference(alignment, "alignment") }?.alignment;
        // SAFETY: as above.
        let camera = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        let camera = camera.cam_from_ar(axes(pose_axes)?)?;
        let map_from_cam = alignment.cam_from_map(&camera).ok_or_else(not_aligned)?.inverse();
        let [w, x, y, z] = map_from_cam.quaternion();
        let pose = VeilocPose { position: (*map_from_cam.translation()).into(), rotation: [x, y, z, w] };
        // SAFETY: as above.
        unsafe { pointers::give(out, pose, "out") }?;
        // SAFETY: as above.
        if let Some(place) = unsafe { pointers::optional_mutable(accuracy) } {
            *place = alignment.accuracy(&camera).ok_or_else(not_aligned)?.into();
        }
        Ok(())
    })
}

/// Takes the pose of the camera between answers, once or twice a second: the length of its path tells how far the AR
/// framework may have drifted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_moved(
    alignment: *mut VeilocAlignment,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let alignment = unsafe { pointers::mutable(alignment, "alignment") }?;
        // SAFETY: as above.
        let camera = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        alignment.alignment.moved(&camera.cam_from_ar(axes(pose_axes)?)?);
        Ok(())
    })
}

/// Forgets all answers: for a new AR session, or when the framework says that it lost its world.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_reset(alignment: *mut VeilocAlignment) {
    // SAFETY: the contract of the crate.
    if let Some(alignment) = unsafe { pointers::optional_mutable(alignment) } {
        alignment.alignment.reset();
    }
}

fn not_aligned() -> Failure {
    Failure::new(VeilocStatus::NotAligned, "there is no trusted answer yet")
}

/// Frees an alignment.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_alignment_free(alignment: *mut VeilocAlignment) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(alignment) }
}
