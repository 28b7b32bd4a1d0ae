//! The profile of a map: `GET /v1/maps/{map}/profile`.

use std::ffi::{CString, c_char};

use veiloc_protocol::Profile;

use crate::pointers;
use crate::status::{Failure, VeilocStatus, guarded};

/// What a device needs to seal for a map.
pub struct VeilocProfile {
    pub(crate) profile: Profile,
    id: CString,
}

impl VeilocProfile {
    pub(crate) fn new(profile: Profile) -> Self {
        let id = CString::new(profile.id().to_string()).unwrap_or_default();
        Self { profile, id }
    }
}

/// Reads a profile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_profile_new(
    bytes: *const u8,
    length: usize,
    out: *mut *mut VeilocProfile,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let bytes = unsafe { pointers::slice(bytes, length, "bytes") }?;
        let profile = Profile::decode(bytes).map_err(|e| Failure::new(VeilocStatus::Profile, e))?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocProfile::new(profile)) }
    })
}

/// The id of the profile, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a
/// profile that was made for one device. Valid as long as the profile; null for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_profile_id(profile: *const VeilocProfile) -> *const c_char {
    // SAFETY: the contract of the crate.
    unsafe { pointers::optional(profile) }.map_or(std::ptr::null(), |profile| profile.id.as_ptr())
}

/// Frees a profile. Sealers that were made with it stay usable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_profile_free(profile: *mut VeilocProfile) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(profile) }
}
