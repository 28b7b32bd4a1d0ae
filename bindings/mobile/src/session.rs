//! Sessions: several frames of one place.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use veiloc_obfuscation::{SessionOptions, device_rng};

use crate::error::VeilocException;

/// Frames of one place, sealed so that their lines do not cross in the keypoints.
#[derive(uniffi::Object)]
pub struct Session {
    session: Mutex<veiloc_obfuscation::Session>,
}

impl Session {
    /// A poisoned lock is safe: a session changes only after sealing succeeded.
    pub(crate) fn locked(&self) -> MutexGuard<'_, veiloc_obfuscation::Session> {
        self.session.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[uniffi::export]
impl Session {
    /// Begins a session. `anchors`: `world` (the default), `gravity` or `image`.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for another word.
    #[uniffi::constructor(default(anchors = "world"))]
    pub fn new(anchors: String) -> Result<Arc<Self>, VeilocException> {
        let options =
            SessionOptions::default().with_anchors(anchors.parse().map_err(VeilocException::argument)?);
        let session = veiloc_obfuscation::Session::new(options, &mut device_rng()?);
        Ok(Arc::new(Self { session: Mutex::new(session) }))
    }

    /// Reads a session that `toBytes` wrote.
    ///
    /// # Errors
    /// [`VeilocException::SessionBytes`].
    #[uniffi::constructor]
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Arc<Self>, VeilocException> {
        let session = veiloc_obfuscation::Session::from_bytes(&bytes)?;
        Ok(Arc::new(Self { session: Mutex::new(session) }))
    }

    /// The session as bytes, to go on after the app was closed. They hold positions of keypoints: keep them in the
    /// app's private storage, and never send them.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.locked().to_bytes()
    }

    /// Frames that were sealed.
    pub fn frames(&self) -> u32 {
        self.locked().frames()
    }

    /// How often new anchors were chosen.
    pub fn starts(&self) -> u32 {
        self.locked().starts()
    }
}
