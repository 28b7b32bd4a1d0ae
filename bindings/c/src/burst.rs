//! Bursts: a few frames of the last second, localized together.

use std::sync::{Mutex, MutexGuard, PoisonError};

use veiloc_ar::{Burst, BurstOptions, SealedBurst};
use veiloc_obfuscation::{SealError, device_rng};

use crate::answer::VeilocAnswer;
use crate::bytes::VeilocBytes;
use crate::camera::{VeilocCamera, VeilocFrame, camera};
use crate::cancellation::VeilocCancellation;
use crate::pointers;
use crate::pose::{VeilocPose, axes};
use crate::query::VeilocQueryInfo;
use crate::sealer::VeilocSealer;
use crate::session::VeilocSession;
use crate::status::{Failure, VeilocStatus, guarded};

/// The sharpest frames of the last second. Unlike other handles, one thread may offer frames while another seals.
///
/// It copies the gray bytes of the frames that it keeps: at most `frames` times width times height.
pub struct VeilocBurst {
    burst: Mutex<Burst>,
}

/// A burst that was sealed.
pub struct VeilocSealedBurst {
    sealed: SealedBurst,
}

/// Which frames a burst keeps, and how exact their poses are. Zero is the default of each.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocBurstOptions {
    /// Most frames that are sealed together, 1 to 5; default 3. Each costs the service as much as one query.
    pub frames: u32,
    /// How far back the frames reach, seconds; default 1.
    pub window: f64,
    /// Standard deviation of the rotation between one kept frame and the next, degrees; default 0.1: of the tracking of
    /// ARKit and ARCore over a second.
    pub rotation_sd_deg: f64,
    /// The same of the position, metres; default 0.01.
    pub translation_sd: f64,
    /// Metres of a unit of the map, as `GET /v1/maps` and every answer state it; default not known: until
    /// `veiloc_burst_learn_unit` learns it, one frame is sealed at a time.
    pub metres_per_unit: f64,
}

/// What is known about a burst that was sealed.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocSealedBurstInfo {
    /// Frames that were sealed.
    pub frames: u32,
    /// Frames that could not be sealed.
    pub left_out: u32,
    /// The newest frame that was sealed, for `veiloc_advice`. It has no steps.
    pub newest: VeilocQueryInfo,
}

impl VeilocBurst {
    fn locked(&self) -> MutexGuard<'_, Burst> {
        // A poisoned lock is safe: a frame is added as the last step.
        self.burst.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Begins a burst without frames. `options`: null for the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_new(
    options: *const VeilocBurstOptions,
    out: *mut *mut VeilocBurst,
) -> VeilocStatus {
    guarded(|| {
        let mut own = BurstOptions::default();
        // SAFETY: the contract of the crate.
        if let Some(given) = unsafe { pointers::optional(options) } {
            let or = |given: f64, own: f64| if given == 0.0 { own } else { given };
            own = own
                .with_frames(if given.frames == 0 {
                    BurstOptions::default().frames
                } else {
                    given.frames as usize
                })
                .with_window(or(given.window, own.window))
                .with_sds(
                    or(given.rotation_sd_deg, own.rotation_sd_deg),
                    or(given.translation_sd, own.translation_sd),
                );
            if given.metres_per_unit != 0.0 {
                own = own.with_metres_per_unit(given.metres_per_unit);
            }
        }
        let burst = Mutex::new(Burst::new(own)?);
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocBurst { burst }) }
    })
}

/// Takes the unit of the map from an answer, unless the options gave one. Call it with every answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_learn_unit(
    burst: *const VeilocBurst,
    answer: *const VeilocAnswer,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the other.
        let burst = unsafe { pointers::reference(burst, "burst") }?;
        // SAFETY: as above.
        burst.locked().learn_unit(&unsafe { pointers::reference(answer, "answer") }?.answer);
        Ok(())
    })
}

/// Takes a frame of the camera if it is the sharpest of its part of the window so far. Offer every frame while the AR
/// framework tracks the camera.
///
/// - `camera`: null for a guessed focal length.
/// - `camera_in_world`: the pose of the camera when it took the frame, in `pose_axes` (a `VeilocAxes`).
/// - `timestamp`: seconds of any clock that does not jump, when the camera took the frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_offer(
    burst: *const VeilocBurst,
    frame: *const VeilocFrame,
    camera_of_frame: *const VeilocCamera,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    timestamp: f64,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let burst = unsafe { pointers::reference(burst, "burst") }?;
        // SAFETY: as above.
        let given = unsafe { pointers::reference(frame, "frame") }?;
        // SAFETY: as above.
        let hidden = unsafe { given.hidden() }?;
        // SAFETY: as above.
        let frame = unsafe { given.frame() }?.hiding(hidden.as_ref()).map_err(SealError::from)?;
        // SAFETY: as above.
        let known = unsafe { camera(camera_of_frame, given) }?;
        // SAFETY: as above.
        let pose = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        let pose = pose.cam_from_ar(axes(pose_axes)?)?;
        burst.locked().offer(&frame, &known, &pose, timestamp)?;
        Ok(())
    })
}

/// Frames that `veiloc_burst_seal` would seal; 0 for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_frames(burst: *const VeilocBurst) -> u32 {
    // SAFETY: the contract of the crate.
    unsafe { pointers::optional(burst) }.map_or(0, |burst| burst.locked().len() as u32)
}

/// Drops the frames: for a new AR session, or when the framework says that it lost its world. Does nothing for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_clear(burst: *const VeilocBurst) {
    // SAFETY: the contract of the crate.
    if let Some(burst) = unsafe { pointers::optional(burst) } {
        burst.locked().clear();
    }
}

/// Seals the frames in the session of their place, and forgets them. A frame that cannot be sealed is left out.
/// `cancellation`: as for `veiloc_sealer_extract`.
///
/// Fails when no frame can be sealed; the session has not changed then, and the frames are gone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_seal(
    burst: *const VeilocBurst,
    sealer: *const VeilocSealer,
    session: *mut VeilocSession,
    cancellation: *const VeilocCancellation,
    out: *mut *mut VeilocSealedBurst,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let burst = unsafe { pointers::reference(burst, "burst") }?;
        // SAFETY: as above.
        let sealer = &unsafe { pointers::reference(sealer, "sealer") }?.sealer;
        // SAFETY: as above.
        let session = &mut unsafe { pointers::mutable(session, "session") }?.session;
        // SAFETY: as above.
        let cancellation = unsafe { pointers::optional(cancellation) };
        let stop = cancellation.map(|cancellation| cancellation.stop.clone()).unwrap_or_default();
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        // The camera goes on while this thread seals.
        let mut taken = burst.locked().take();
        let sealed = taken.seal(sealer, session, &stop, &mut device_rng()?)?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocSealedBurst { sealed }) }
    })
}

/// Frees a burst.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_burst_free(burst: *mut VeilocBurst) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(burst) }
}

/// The bytes of a sealed burst, for `POST /v1/maps/{map}/localize-rig`: all that leaves the device. After a network
/// error, send the same bytes again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealed_burst_bytes(
    sealed: *const VeilocSealedBurst,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let VeilocSealedBurst { sealed } = unsafe { pointers::reference(sealed, "sealed") }?;
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        // SAFETY: as above.
        unsafe { pointers::give(out, sealed.message.encode().into(), "out") }
    })
}

/// The pose of the camera when it took the newest frame of the burst: with the answer, for `veiloc_alignment_add`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealed_burst_camera_in_world(
    sealed: *const VeilocSealedBurst,
    pose_axes: u32,
    out: *mut VeilocPose,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let VeilocSealedBurst { sealed } = unsafe { pointers::reference(sealed, "sealed") }?;
        let pose = axes(pose_axes)?.camera_pose(&sealed.cam_from_ar);
        // SAFETY: as above.
        unsafe { pointers::give(out, pose.into(), "out") }
    })
}

/// What is known about a sealed burst; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealed_burst_info(sealed: *const VeilocSealedBurst) -> VeilocSealedBurstInfo {
    // SAFETY: the contract of the crate.
    let Some(VeilocSealedBurst { sealed }) = (unsafe { pointers::optional(sealed) }) else {
        return VeilocSealedBurstInfo::default();
    };
    VeilocSealedBurstInfo {
        frames: sealed.message.frames.len() as u32,
        left_out: sealed.left_out as u32,
        newest: VeilocQueryInfo {
            rows: sealed.message.frames.first().map_or(0, |frame| frame.query.len() as u32),
            keypoints: sealed.keypoints as u32,
            brightness: sealed.brightness,
            ..VeilocQueryInfo::default()
        },
    }
}

/// Frees a sealed burst.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealed_burst_free(sealed: *mut VeilocSealedBurst) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(sealed) }
}
