//! The id of a profile.

use std::fmt;
use std::str::FromStr;

use sha2::{Digest, Sha256};

use crate::QueryError;

/// The id of a profile: the first 16 bytes of the SHA-256 of its encoding. Printed as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ProfileId([u8; 16]);

impl ProfileId {
    /// From its bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    pub const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }

    /// The id of an encoded profile.
    pub(crate) fn of(encoded: &[u8]) -> Self {
        let mut id = [0; 16];
        id.copy_from_slice(&Sha256::digest(encoded)[..16]);
        Self(id)
    }
}

impl fmt::Display for ProfileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// 32 hexadecimal digits, as printed.
impl FromStr for ProfileId {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let invalid = || QueryError::ProfileId { text: text.to_owned() };
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

impl fmt::Debug for ProfileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ProfileId({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_read_as_they_are_printed() {
        let id = ProfileId::of(b"a profile");
        assert_eq!(id.to_string().parse::<ProfileId>().expect("an id"), id);
        assert_eq!(id.to_string().to_uppercase().parse::<ProfileId>().expect("an id"), id);
        for text in [
            "",
            "12",
            &"g".repeat(32),
            &"1".repeat(31),
            &"1".repeat(33),
            &"\u{e9}".repeat(16),
            &format!("+{}", "1".repeat(31)),
        ] {
            assert!(text.parse::<ProfileId>().is_err(), "{text}");
        }
    }
}
