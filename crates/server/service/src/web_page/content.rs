//! Immutable shared bytes with their hash.

use bytes::Bytes;
use sha2::{Digest as _, Sha256};

/// Shared bytes, identified by their hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Content {
    bytes: Bytes,
    hash: String,
}

impl Content {
    /// Takes the bytes and hashes them.
    pub fn new(bytes: impl Into<Bytes>) -> Self {
        let bytes = bytes.into();
        let hash = hex::encode(Sha256::digest(&bytes));
        Self { bytes, hash }
    }

    /// The bytes; cloning them copies nothing.
    pub const fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// The strong entity tag (RFC 9110): their SHA-256 in quotation marks.
    pub fn etag(&self) -> String {
        format!("\"{}\"", self.hash)
    }

    /// Their SHA-256, 64 hexadecimal digits.
    pub fn hash(&self) -> &str {
        &self.hash
    }
}
