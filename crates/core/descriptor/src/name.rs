//! Short names in files and messages: of descriptor kinds and of global models.

use crate::DescriptorError;

/// A name of 1 to 31 characters from `a`–`z`, `0`–`9` and `-`, beginning with a letter. Stored inline, so that types
/// with it are `Copy`; 32 bytes, padded with zeros.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Name([u8; Name::BYTES]);

impl Name {
    /// Bytes in files and messages, padded with zeros.
    pub const BYTES: usize = 32;
    /// Maximum length, characters.
    pub const MAX_LEN: usize = Self::BYTES - 1;

    /// Checks a name.
    ///
    /// # Errors
    /// [`DescriptorError::Name`] when it is empty, too long, does not begin with a letter or contains another
    /// character.
    pub fn new(text: &str) -> Result<Self, DescriptorError> {
        Self::checked(text).ok_or(DescriptorError::Name)
    }

    /// The same for names in the code.
    pub(crate) const fn checked(text: &str) -> Option<Self> {
        let text = text.as_bytes();
        if text.is_empty() || text.len() > Self::MAX_LEN || !text[0].is_ascii_lowercase() {
            return None;
        }
        let mut bytes = [0; Self::BYTES];
        let mut at = 0;
        while at < text.len() {
            if !matches!(text[at], b'a'..=b'z' | b'0'..=b'9' | b'-') {
                return None;
            }
            bytes[at] = text[at];
            at += 1;
        }
        Some(Self(bytes))
    }

    /// Reads the output of [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`DescriptorError::Name`] for bytes that are not a name padded with zeros.
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Result<Self, DescriptorError> {
        let length = bytes.iter().position(|b| *b == 0).unwrap_or(Self::BYTES);
        let text = std::str::from_utf8(&bytes[..length]).map_err(|_| DescriptorError::Name)?;
        let name = Self::new(text)?;
        if name.0 == *bytes { Ok(name) } else { Err(DescriptorError::Name) }
    }

    /// Its bytes, padded with zeros.
    pub const fn to_bytes(self) -> [u8; Self::BYTES] {
        self.0
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        let length = self.0.iter().position(|b| *b == 0).unwrap_or(Self::BYTES);
        std::str::from_utf8(&self.0[..length]).expect("the constructors accept ASCII only")
    }
}

impl std::fmt::Display for Name {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.as_str())
    }
}

impl std::fmt::Debug for Name {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

impl std::str::FromStr for Name {
    type Err = DescriptorError;

    fn from_str(text: &str) -> Result<Self, DescriptorError> {
        Self::new(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_invalid_ones_are_rejected() {
        let longest = "a".repeat(31);
        for text in ["sift", "superpoint-256", "a", &longest] {
            let name = Name::new(text).expect("a name");
            assert_eq!(name.as_str(), text);
            assert_eq!(Name::from_bytes(&name.to_bytes()), Ok(name));
        }
        for text in ["", "Sift", "si ft", "0sift", "-a", "sïft", "a/b", "a\0", &"a".repeat(32)] {
            assert_eq!(Name::new(text), Err(DescriptorError::Name), "{text:?}");
        }
    }

    #[test]
    fn bytes_are_canonical() {
        let mut bytes = Name::new("sift").expect("a name").to_bytes();
        bytes[20] = b'x';
        assert_eq!(Name::from_bytes(&bytes), Err(DescriptorError::Name), "bytes after the end");
        assert_eq!(Name::from_bytes(&[0; 32]), Err(DescriptorError::Name));
        assert_eq!(Name::from_bytes(&[b'a'; 32]), Err(DescriptorError::Name), "no end");
        assert_eq!(Name::from_bytes(&[0xFF; 32]), Err(DescriptorError::Name));
    }
}
