//! The pack of a map: `GET /v1/maps/{map}/pack`.

use std::ffi::{CString, c_char};

use veiloc_obfuscation::{KnownPlace, PackUse};
use veiloc_protocol::Pack;

use crate::pointers;
use crate::profile::VeilocProfile;
use crate::status::{Failure, VeilocStatus, guarded};

/// What a place looks like, without where: with it a device sends only what the place knows. Several sealers may share it.
pub struct VeilocPack {
    pub(crate) place: KnownPlace,
    id: CString,
}

/// What is sent with a pack.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocPackUse {
    /// The points that keypoints match in the pack, and no descriptor.
    Matches = 0,
    /// The descriptors that the pack explains.
    Explained = 1,
}

pub(crate) fn pack_use(number: u32) -> Result<PackUse, Failure> {
    match number {
        0 => Ok(PackUse::Matches),
        1 => Ok(PackUse::Explained),
        _ => Err(Failure::new(VeilocStatus::Argument, format!("options.send: {number} is no VeilocPackUse"))),
    }
}

/// Reads a pack and prepares it, which takes about a millisecond per thousand rows: call it on a thread of its own, once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pack_new(
    bytes: *const u8,
    length: usize,
    out: *mut *mut VeilocPack,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let bytes = unsafe { pointers::slice(bytes, length, "bytes") }?;
        let pack = Pack::decode(bytes).map_err(|e| Failure::new(VeilocStatus::Pack, e))?;
        let id = CString::new(pack.id().to_string()).unwrap_or_default();
        let place = KnownPlace::new(pack).map_err(|e| Failure::new(VeilocStatus::Pack, e))?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocPack { place, id }) }
    })
}

/// The id of the pack, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a pack that
/// was made for one device. Valid as long as the pack; null for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pack_id(pack: *const VeilocPack) -> *const c_char {
    // SAFETY: the contract of the crate.
    unsafe { pointers::optional(pack) }.map_or(std::ptr::null(), |pack| pack.id.as_ptr())
}

/// The profile of the map, which a pack contains: an app that has the pack need not fetch it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pack_profile(
    pack: *const VeilocPack,
    out: *mut *mut VeilocProfile,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let pack = unsafe { pointers::reference(pack, "pack") }?;
        let profile = VeilocProfile::new(pack.place.pack().profile().clone());
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, profile) }
    })
}

/// Frees a pack. Sealers that were made with it stay usable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_pack_free(pack: *mut VeilocPack) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(pack) }
}
