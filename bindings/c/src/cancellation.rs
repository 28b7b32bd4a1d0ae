//! Stopping an extraction from another thread.

use veiloc_geometry::Stop;

use crate::pointers;
use crate::status::{VeilocStatus, guarded};

/// A request to stop. Unlike other handles, any thread may use it while another extracts with it.
#[derive(Default)]
pub struct VeilocCancellation {
    pub(crate) stop: Stop,
}

/// Makes a request that was not made yet. Free it after the calls that it was given to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_cancellation_new(out: *mut *mut VeilocCancellation) -> VeilocStatus {
    // SAFETY: the contract of the crate.
    guarded(|| unsafe { pointers::give_handle(out, VeilocCancellation::default()) })
}

/// Makes the request: calls that were given it, running and later ones, fail with `Cancelled`. It cannot be revoked. Does
/// nothing for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_cancel(cancellation: *const VeilocCancellation) {
    // SAFETY: the contract of the crate. Only a shared reference is made, and a flag may be set through it.
    if let Some(cancellation) = unsafe { pointers::optional(cancellation) } {
        cancellation.stop.set();
    }
}

/// Frees a request.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_cancellation_free(cancellation: *mut VeilocCancellation) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(cancellation) }
}
