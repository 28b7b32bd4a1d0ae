//! The profile of a map: `GET /v1/maps/{map}/profile`.

use std::sync::Arc;

use crate::error::VeilocException;

/// What a device needs to seal for a map.
#[derive(uniffi::Object)]
pub struct Profile {
    pub(crate) profile: veiloc_protocol::Profile,
}

#[uniffi::export]
impl Profile {
    /// Reads a profile.
    ///
    /// # Errors
    /// [`VeilocException::Profile`].
    #[uniffi::constructor]
    pub fn new(bytes: Vec<u8>) -> Result<Arc<Self>, VeilocException> {
        let profile = veiloc_protocol::Profile::decode(&bytes);
        let profile = profile.map_err(|e| VeilocException::Profile(e.to_string()))?;
        Ok(Arc::new(Self { profile }))
    }

    /// The id of the profile, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a
    /// profile that was made for one device.
    pub fn id(&self) -> String {
        self.profile.id().to_string()
    }
}
