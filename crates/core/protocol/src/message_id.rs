//! The ids by which clients pin what a server publishes.

use std::fmt;
use std::str::FromStr;

use sha2::{Digest, Sha256};

use crate::QueryError;

/// The first 16 bytes of the SHA-256 of an encoded message. Printed as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MessageId([u8; 16]);

/// The id of a [`Profile`](crate::Profile).
pub type ProfileId = MessageId;

/// The id of a [`Pack`](crate::Pack).
pub type PackId = MessageId;

impl MessageId {
    /// From its bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    pub const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }

    /// The id of an encoded message.
    pub(crate) fn of(encoded: &[u8]) -> Self {
        let mut id = [0; 16];
        id.copy_from_slice(&Sha256::digest(encoded)[..16]);
        Self(id)
    }
}

impl fmt::Display for MessageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// 32 hexadecimal digits, as printed.
impl FromStr for MessageId {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let invalid = || QueryError::MessageId { text: text.to_owned() };
        if text.len() != 32 || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(invalid());
        }
        let mut id = [0; 16];
        for (byte, at) in id.iter_mut().zip((0..32).step_by(2)) {
            *byte = u8::from_str_radix(&text[at..at + 2], 16).map_err(|_| invalid())?;
        }
        Ok(Self(id))
    }
}

impl fmt::Debug for MessageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MessageId({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_read_as_they_are_printed() {
        let id = MessageId::of(b"a profile");
        assert_eq!(id.to_string().parse::<MessageId>().expect("an id"), id);
        assert_eq!(id.to_string().to_uppercase().parse::<MessageId>().expect("an id"), id);
        for text in [
            "",
            "12",
            &"g".repeat(32),
            &"1".repeat(31),
            &"1".repeat(33),
            &"\u{e9}".repeat(16),
            &format!("+{}", "1".repeat(31)),
        ] {
            assert!(text.parse::<MessageId>().is_err(), "{text}");
        }
    }
}
