//! Sessions: several frames of one place.

use std::ffi::c_char;

use veiloc_obfuscation::{Session, SessionOptions, device_rng};

use crate::bytes::VeilocBytes;
use crate::pointers;
use crate::status::{Failure, VeilocStatus, guarded};

/// Frames of one place, sealed so that their lines do not cross in the keypoints.
pub struct VeilocSession {
    pub(crate) session: Session,
}

/// Counts of a session.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VeilocSessionInfo {
    /// Frames that were sealed.
    pub frames: u32,
    /// How often new anchors were chosen.
    pub starts: u32,
}

/// Begins a session. `anchors`: `world` (also for null), `gravity` or `image`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_session_new(
    anchors: *const c_char,
    out: *mut *mut VeilocSession,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let anchors = unsafe { pointers::text(anchors, "anchors") }?.map(str::parse).transpose();
        let anchors = anchors.map_err(|e| Failure::new(VeilocStatus::Argument, e))?.unwrap_or_default();
        let options = SessionOptions::default().with_anchors(anchors);
        let session = Session::new(options, &mut device_rng()?);
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocSession { session }) }
    })
}

/// Reads a session that `veiloc_session_to_bytes` wrote.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_session_from_bytes(
    bytes: *const u8,
    length: usize,
    out: *mut *mut VeilocSession,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let bytes = unsafe { pointers::slice(bytes, length, "bytes") }?;
        let session = Session::from_bytes(bytes)?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocSession { session }) }
    })
}

/// The session as bytes, to go on after the app was closed. They hold positions of keypoints: keep them in the app's
/// private storage, and never send them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_session_to_bytes(
    session: *const VeilocSession,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let session = unsafe { pointers::reference(session, "session") }?;
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        // SAFETY: as above.
        unsafe { pointers::give(out, session.session.to_bytes().into(), "out") }
    })
}

/// Counts of a session; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_session_info(session: *const VeilocSession) -> VeilocSessionInfo {
    // SAFETY: the contract of the crate.
    let session = unsafe { pointers::optional(session) }.map(|session| &session.session);
    session.map_or_else(VeilocSessionInfo::default, |session| VeilocSessionInfo {
        frames: session.frames(),
        starts: session.starts(),
    })
}

/// Frees a session.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_session_free(session: *mut VeilocSession) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(session) }
}
