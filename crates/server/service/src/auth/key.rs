//! Identifies a token by its hash, which is never printed completely.

use std::fmt;

use sha2::{Digest as _, Sha256};

/// The SHA-256 of a token.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TokenKey([u8; 32]);

impl TokenKey {
    /// From the SHA-256 of a token.
    pub const fn of_digest(digest: [u8; 32]) -> Self {
        Self(digest)
    }

    /// From the token as received.
    pub fn of_token(token: &[u8]) -> Self {
        Self(Sha256::digest(token).into())
    }

    /// From the hash in hexadecimal, 64 digits in either case; `None` for anything else.
    pub fn of_hex(hex: &str) -> Option<Self> {
        let mut digest = [0; 32];
        hex::decode_to_slice(hex, &mut digest).ok()?;
        Some(Self(digest))
    }

    /// All 64 digits, for the token file only.
    pub(crate) fn hex(&self) -> String {
        hex::encode(self.0)
    }

    /// The first eight digits: enough to identify a line, useless for guessing the token.
    pub fn beginning(&self) -> String {
        self.hex()[..8].to_owned()
    }
}

impl fmt::Debug for TokenKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TokenKey")
    }
}
