//! Bytes that are handed out many times, and the name of what they say.

use bytes::Bytes;
use sha2::{Digest as _, Sha256};

/// Bytes, shared by all who are given them, and a name that other bytes do not have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Content {
    bytes: Bytes,
    hash: String,
}

impl Content {
    /// Takes the bytes, and names them.
    pub fn new(bytes: impl Into<Bytes>) -> Self {
        let bytes = bytes.into();
        let hash = hex::encode(Sha256::digest(&bytes));
        Self { bytes, hash }
    }

    /// All of them; to clone these copies nothing.
    pub const fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// Their SHA-256, 64 hexadecimal digits.
    pub fn hash(&self) -> &str {
        &self.hash
    }
}
