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

/// Identifies the client of a token to workers, whose queues are fair between clients. It is a hash of the
/// key, so that workers do not get what the file of tokens holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lane([u8; 32]);

impl Lane {
    /// The lane of a token.
    pub fn of(key: &TokenKey) -> Self {
        Self(Sha256::new().chain_update(b"veiloc lane").chain_update(key.0).finalize().into())
    }

    /// From 64 hexadecimal digits; `None` for anything else.
    pub fn of_hex(hex: &str) -> Option<Self> {
        TokenKey::of_hex(hex).map(|key| Self(key.0))
    }

    /// As 64 hexadecimal digits.
    pub fn hex(&self) -> String {
        hex::encode(self.0)
    }

    /// As the key of a queue.
    pub const fn key(self) -> TokenKey {
        TokenKey(self.0)
    }
}

impl fmt::Debug for Lane {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Lane")
    }
}

impl fmt::Debug for TokenKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TokenKey")
    }
}
