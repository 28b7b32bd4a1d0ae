//! A token, which is printed once and never stored.

use std::fmt;

use crate::auth::key::TokenKey;

/// A token of 256 random bits.
pub struct Secret(String);

impl Secret {
    /// From 32 bytes that the caller drew from the generator of the system.
    pub fn of_random(bytes: [u8; 32]) -> Self {
        Self(hex::encode(bytes))
    }

    /// The token, 64 hexadecimal digits. The caller must show it only to its owner.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Its hash.
    pub fn key(&self) -> TokenKey {
        TokenKey::of_token(self.0.as_bytes())
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_hides_token_and_hash() {
        let secret = Secret::of_random(std::array::from_fn(|i| i as u8));
        assert_eq!(secret.reveal(), "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f");
        // `printf %s 0001…1e1f | sha256sum`
        assert_eq!(secret.key().hex(), "6c86c6aac5fb24bcf5d9939cb7d7d5645ce39418f449e03b262dd4fa14b4b92b");
        assert_eq!(format!("{secret:?} {:?}", secret.key()), "Secret TokenKey");
    }
}
