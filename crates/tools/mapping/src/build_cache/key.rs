//! Hash of the inputs of a computation.

use sha2::{Digest as _, Sha256};

/// Hash of the inputs of a computation; the version of this program is part of it.
#[derive(Debug, Clone)]
pub struct CacheKey(Sha256);

impl CacheKey {
    /// Begins the hash for a computation with this name.
    pub fn new(what: &str) -> Self {
        let mut key = Self(Sha256::new());
        key.text(what);
        key.text(env!("CARGO_PKG_VERSION"));
        key
    }

    /// Adds bytes with their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    /// Adds a text.
    pub fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// Adds the debug output of a value.
    pub fn debug(&mut self, value: &impl std::fmt::Debug) {
        self.text(&format!("{value:?}"));
    }

    /// Adds the exact bits of numbers.
    pub fn numbers(&mut self, numbers: impl Iterator<Item = f64>) {
        numbers.for_each(|n| self.0.update(n.to_le_bytes()));
    }

    /// The hash.
    pub fn digest(self) -> [u8; 32] {
        self.0.finalize().into()
    }

    /// The hash in hexadecimal.
    pub fn hex(self) -> String {
        hex::encode(self.digest())
    }
}
