//! Which version of the messages: version 1 is read, and answered, for ever.

/// Version of a profile or a sealed query. Profiles have the first two; a query sealed with a profile of version 2 is of
/// version 3, or of version 4 where that is needed to say its layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum WireVersion {
    /// RootSIFT and a vocabulary; the profile holds a scheme, as the operator's wish.
    V1,
    /// Any descriptor kind and global model; the profile holds no scheme, because the device decides.
    V2,
    /// Queries only: says how well the focal length is known, and may say which way is down.
    V3,
    /// Queries of `dcl` only: any layout, and how it is turned against the camera.
    V4,
}

impl WireVersion {
    /// All versions, oldest first.
    pub const ALL: [Self; 4] = [Self::V1, Self::V2, Self::V3, Self::V4];
    /// Those of profiles.
    pub(crate) const OF_PROFILES: [Self; 2] = [Self::V1, Self::V2];

    /// The number in the messages.
    pub const fn number(self) -> u32 {
        match self {
            Self::V1 => 1,
            Self::V2 => 2,
            Self::V3 => 3,
            Self::V4 => 4,
        }
    }
}
