//! Sealed queries: the bytes to send.

use std::sync::Arc;

use veiloc_ar::rig_message;
use veiloc_obfuscation::Sealer;
use veiloc_protocol::{SealedQuery, SizeClass};

use crate::bytes::VeilocBytes;
use crate::pointers;
use crate::pose::{VeilocPose, axes};
use crate::status::{Failure, VeilocStatus, guarded};

/// A sealed query.
pub struct VeilocQuery {
    pub(crate) query: SealedQuery,
    pub(crate) sealer: Arc<Sealer>,
    pub(crate) keypoints: usize,
    pub(crate) brightness: f64,
}

/// What is known about a sealed query.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocQueryInfo {
    /// Rows of the query.
    pub rows: u32,
    /// Keypoints that were found in the frame.
    pub keypoints: u32,
    /// Mean gray of the frame, 0 to 1.
    pub brightness: f64,
    /// How many of `steps` are used.
    pub step_count: u32,
    /// Rows of each step of progressive localization that can determine a pose, ascending.
    pub steps: [u32; 8],
}

/// What is known about a query; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_info(query: *const VeilocQuery) -> VeilocQueryInfo {
    let mut info = VeilocQueryInfo::default();
    // SAFETY: the contract of the crate.
    if let Some(own) = unsafe { pointers::optional(query) } {
        info.rows = own.query.len() as u32;
        info.keypoints = own.keypoints as u32;
        info.brightness = own.brightness;
        for (step, class) in info.steps.iter_mut().zip(own.query.useful_steps(own.sealer.profile())) {
            *step = class.rows() as u32;
            info.step_count += 1;
        }
    }
    info
}

/// The bytes of a query, for `POST /v1/maps/{map}/localize`: all that leaves the device. `rows`: 0 for all rows, or a
/// step of `VeilocQueryInfo`. After a network error, send the same bytes again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_bytes(
    query: *const VeilocQuery,
    rows: u32,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let VeilocQuery { query, sealer, .. } = unsafe { pointers::reference(query, "query") }?;
        let bytes = if rows == 0 {
            query.encode()
        } else {
            let argument = |e: &dyn std::fmt::Display| Failure::new(VeilocStatus::Argument, e);
            let class = SizeClass::from_rows(rows as usize)
                .ok_or_else(|| argument(&format!("{rows} rows are not a step of the query")))?;
            query.first_rows(class, sealer.profile()).map_err(|e| argument(&e))?.encode()
        };
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        // SAFETY: as above.
        unsafe { pointers::give(out, bytes.into(), "out") }
    })
}

/// Frees a query.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_free(query: *mut VeilocQuery) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(query) }
}

/// Several queries of one device and their poses, for `POST /v1/maps/{map}/localize-rig`: localized together. The answer
/// is the pose of the first camera.
///
/// `queries` and `cameras_in_world` hold `count` (1 to 32) pointers and poses. Only poses relative to the first are
/// sent. `rotation_sd_deg` and `translation_sd` (metres): how exact the AR framework's poses are.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_rig_bytes(
    queries: *const *const VeilocQuery,
    pose_axes: u32,
    cameras_in_world: *const VeilocPose,
    count: usize,
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let queries = unsafe { pointers::slice(queries, count, "queries") }?;
        // SAFETY: as above.
        let poses = unsafe { pointers::slice(cameras_in_world, count, "cameras_in_world") }?;
        let axes = axes(pose_axes)?;
        let cameras: Vec<_> = poses.iter().map(|pose| pose.cam_from_ar(axes)).collect::<Result<_, _>>()?;
        let mut sealed = Vec::new();
        for query in queries {
            // SAFETY: as above.
            sealed.push(unsafe { pointers::reference(*query, "a query") }?.query.clone());
        }
        let message = rig_message(sealed, &cameras, metres_per_unit, rotation_sd_deg, translation_sd)
            .map_err(|error| Failure::new(VeilocStatus::Argument, error))?;
        // SAFETY: as above.
        unsafe { pointers::give(out, message.encode().into(), "out") }
    })
}
