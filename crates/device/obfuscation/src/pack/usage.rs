//! What is sent with a pack, and its words.

use std::str::FromStr;

/// What is sent of the rows that a place explains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PackUse {
    /// Their descriptors; the server matches.
    Explained,
    /// The points that they match in the pack, and no descriptor.
    #[default]
    Matches,
}

impl PackUse {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Explained, Self::Matches];

    /// The word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Explained => "explained",
            Self::Matches => "matches",
        }
    }
}

/// The text is not a name of [`PackUse`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not matches or explained")]
pub struct UnknownPackUse {
    /// The text as given.
    pub text: String,
}

/// A word, as [`PackUse::name`] has it.
impl FromStr for PackUse {
    type Err = UnknownPackUse;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|known| known.name() == text);
        known.ok_or_else(|| UnknownPackUse { text: text.to_owned() })
    }
}
