//! The pack of a map: `GET /v1/maps/{map}/pack`.

use std::sync::Arc;

use veiloc_obfuscation::KnownPlace;

use crate::error::VeilocException;
use crate::profile::Profile;

pub use veiloc_obfuscation::PackUse;

/// What a place looks like, without where: with it a device sends only what the place knows. Several sealers may share it.
#[derive(Debug, PartialEq, Eq, uniffi::Object)]
pub struct Pack {
    pub(crate) place: KnownPlace,
}

/// What is sent with a pack.
#[uniffi::remote(Enum)]
pub enum PackUse {
    /// The descriptors that the pack explains.
    Explained,
    /// The points that keypoints match in the pack, and no descriptor.
    Matches,
}

#[uniffi::export]
impl Pack {
    /// Reads a pack and prepares it, which takes about a millisecond per thousand rows: call it on a background thread,
    /// once.
    ///
    /// # Errors
    /// [`VeilocException::Pack`].
    #[uniffi::constructor]
    pub fn new(bytes: Vec<u8>) -> Result<Arc<Self>, VeilocException> {
        let pack = veiloc_protocol::Pack::decode(&bytes).map_err(|e| VeilocException::Pack(e.to_string()))?;
        let place = KnownPlace::new(pack).map_err(|e| VeilocException::Pack(e.to_string()))?;
        Ok(Arc::new(Self { place }))
    }

    /// The id of the pack, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a pack
    /// that was made for one device.
    pub fn id(&self) -> String {
        self.place.pack().id().to_string()
    }

    /// The profile of the map, which a pack contains: an app that has the pack need not fetch it.
    pub fn profile(&self) -> Arc<Profile> {
        Arc::new(Profile { profile: self.place.pack().profile().clone() })
    }
}
