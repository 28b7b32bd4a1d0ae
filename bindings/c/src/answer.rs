//! Answers of the service.

use veiloc_ar::Accuracy;
use veiloc_protocol::{Answer, DoubtKind, StopCriterion};

use crate::bytes::VeilocBytes;
use crate::pointers;
use crate::pose::{VeilocAccuracy, VeilocPose, axes, no_pose};
use crate::status::{Failure, VeilocStatus, guarded};

/// An answer: where a frame was taken.
pub struct VeilocAnswer {
    pub(crate) answer: Answer,
}

/// The numbers of an answer.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocAnswerInfo {
    /// Whether it has a pose. Doubtful poses are withheld when the request asks for it.
    pub has_pose: bool,
    /// Whether there are no doubts about the pose.
    pub trusted: bool,
    /// Standard deviation of the position in its least certain direction, map units; infinite without a pose. Relative
    /// to the map, not to the earth.
    pub position_sd: f64,
    /// Metres of a unit of the map; 0 when the unit is not known.
    pub metres_per_unit: f64,
    /// Direction of gravity in the map, a unit vector; zeros when the map does not know it.
    pub down: [f64; 3],
    /// Rows that agree with the pose.
    pub inliers: u32,
    /// Rows that were matched to map points.
    pub matches: u32,
    /// Doubts: bit 0 other, 1 weak evidence, 2 ambiguous, 3 imprecise, 4 one-sided.
    pub doubts: u32,
}

/// Reads an answer: the body of status 200 to a request with `accept: application/x-protobuf`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_new(
    bytes: *const u8,
    length: usize,
    out: *mut *mut VeilocAnswer,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let bytes = unsafe { pointers::slice(bytes, length, "bytes") }?;
        let answer = Answer::decode(bytes).map_err(|e| Failure::new(VeilocStatus::Answer, e))?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocAnswer { answer }) }
    })
}

/// The numbers of an answer; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_info(answer: *const VeilocAnswer) -> VeilocAnswerInfo {
    // SAFETY: the contract of the crate.
    let Some(VeilocAnswer { answer }) = (unsafe { pointers::optional(answer) }) else {
        return VeilocAnswerInfo::default();
    };
    let bit = |kind: DoubtKind| DoubtKind::ALL.iter().position(|k| *k == kind).map_or(0, |at| 1 << at);
    VeilocAnswerInfo {
        has_pose: answer.pose.is_some(),
        trusted: answer.trusted(),
        position_sd: answer.position_sd(),
        metres_per_unit: answer.map.metres_per_unit.unwrap_or(0.0),
        down: answer.map.down.unwrap_or_default(),
        inliers: answer.inliers,
        matches: answer.matches,
        doubts: answer.doubts.iter().fold(0, |bits, doubt| bits | bit(doubt.kind)),
    }
}

/// Whether a progressive query ends with this answer: it is trusted and, for `position_sd` above 0, its standard
/// deviation is at most that many map units.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_is_enough(answer: *const VeilocAnswer, position_sd: f64) -> bool {
    let criterion = StopCriterion::accurate_to(position_sd).unwrap_or(StopCriterion::TRUSTED);
    // SAFETY: the contract of the crate.
    unsafe { pointers::optional(answer) }
        .is_some_and(|VeilocAnswer { answer }| criterion.is_met(answer.trusted(), answer.position_sd()))
}

/// The answer as JSON, UTF-8 without a final zero: the document that the service gives for `accept: application/json`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_json(
    answer: *const VeilocAnswer,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let answer = &unsafe { pointers::reference(answer, "answer") }?.answer;
        // SAFETY: as above.
        unsafe { pointers::give(out, answer.to_json().into_bytes().into(), "out") }
    })
}

/// Where the camera is in the map, with the axes of a framework in place of the map's: for apps that draw the map. For
/// content in the AR world use an alignment. `metres_per_unit`: 0 for the unit that the answer states.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_camera_in_map(
    answer: *const VeilocAnswer,
    pose_axes: u32,
    metres_per_unit: f64,
    out: *mut VeilocPose,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let answer = &unsafe { pointers::reference(answer, "answer") }?.answer;
        let pose = answer.pose.as_ref().ok_or_else(without_pose)?;
        let metres = unit(answer, metres_per_unit)?;
        let pose = axes(pose_axes)?.camera_in_map(pose, metres).ok_or_else(no_pose)?;
        // SAFETY: as above.
        unsafe { pointers::give(out, pose.into(), "out") }
    })
}

/// Radii of 68 % confidence of one answer. `camera_in_world`: the pose of the camera when it took the frame, in axes
/// whose vertical is gravity. `metres_per_unit`: 0 for the unit that the answer states.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_accuracy(
    answer: *const VeilocAnswer,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    metres_per_unit: f64,
    out: *mut VeilocAccuracy,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let answer = &unsafe { pointers::reference(answer, "answer") }?.answer;
        let pose = answer.pose.as_ref().ok_or_else(without_pose)?;
        // SAFETY: as above.
        let camera = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        let metres = unit(answer, metres_per_unit)?;
        let accuracy = Accuracy::of_answer(pose, &camera.cam_from_ar(axes(pose_axes)?)?, metres);
        // SAFETY: as above.
        unsafe { pointers::give(out, accuracy.into(), "out") }
    })
}

fn unit(answer: &Answer, given: f64) -> Result<f64, Failure> {
    let given = (given != 0.0).then_some(given);
    veiloc_ar::metres_per_unit(answer, given).map_err(|error| Failure::new(VeilocStatus::Argument, error))
}

fn without_pose() -> Failure {
    Failure::new(VeilocStatus::Argument, "the answer has no pose")
}

/// Frees an answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_answer_free(answer: *mut VeilocAnswer) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(answer) }
}
