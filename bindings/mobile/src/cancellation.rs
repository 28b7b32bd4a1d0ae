//! Stopping an extraction from another thread.

use std::sync::Arc;

use veiloc_geometry::Stop;

/// A request to stop a call to `Sealer.extract` or `Burst.seal`. In Kotlin, `cancel` it from `invokeOnCompletion` of the coroutine's job.
#[derive(Debug, Default, uniffi::Object)]
pub struct Cancellation {
    pub(crate) stop: Stop,
}

#[uniffi::export]
impl Cancellation {
    /// A request that was not made yet.
    #[uniffi::constructor]
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// Makes the request: calls that were given it, running and later ones, throw `VeilocException.Cancelled`. It cannot be
    /// revoked.
    pub fn cancel(&self) {
        self.stop.set();
    }

    /// Whether the request was made.
    pub fn is_cancelled(&self) -> bool {
        self.stop.is_set()
    }
}

/// The flag of a request; one that is never set without a request.
pub(crate) fn stop_of(cancellation: Option<Arc<Cancellation>>) -> Stop {
    cancellation.map(|cancellation| cancellation.stop.clone()).unwrap_or_default()
}
