//! What the files of networks and of trainings have in common.
//!
//! ```text
//! magic                 8 bytes, says what the file is
//! version               u32
//! head                  of a fixed length
//! body                  of a length that the head tells
//! checksum              u64, XXH3 of all that stands before
//! ```
//! Little-endian throughout.

use xxhash_rust::xxh3::xxh3_64;

use crate::AttackError;

/// What a file is.
#[derive(Debug, Clone, Copy)]
pub struct Format {
    /// The first bytes.
    pub magic: &'static [u8; 8],
    /// The one that is written and read.
    pub version: u32,
    /// For the message where it is none.
    pub expected: &'static str,
}

/// Bytes behind the body.
const TAIL: usize = 8;
/// No honest text is longer, bytes.
const LONGEST_TEXT: usize = 1024;
/// Bytes before the head.
const FRONT: usize = 12;

/// Bytes of a file being written.
pub struct Writer(Vec<u8>);

impl Writer {
    /// With magic and version.
    pub fn new(format: &Format) -> Self {
        let mut bytes = format.magic.to_vec();
        bytes.extend(format.version.to_le_bytes());
        Self(bytes)
    }

    /// Adds small whole numbers.
    pub fn words(&mut self, words: &[u32]) {
        self.0.extend(words.iter().flat_map(|w| w.to_le_bytes()));
    }

    /// Adds a text: its length, then its bytes, filled up with zeros to whole words.
    pub fn text(&mut self, text: &str) {
        // A name that was given is short.
        self.words(&[text.len() as u32]);
        self.0.extend(text.as_bytes());
        self.0.resize(self.0.len() + text.len().next_multiple_of(4) - text.len(), 0);
    }

    /// Adds a whole number.
    pub fn long(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    /// Adds a number to the bit.
    pub fn real(&mut self, number: f64) {
        self.long(number.to_bits());
    }

    /// Adds numbers of a network.
    pub fn numbers(&mut self, numbers: &[f32]) {
        self.0.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    }

    /// With the checksum behind.
    pub fn finish(mut self) -> Vec<u8> {
        let checksum = xxh3_64(&self.0);
        self.long(checksum);
        self.0
    }
}

/// Bytes of a file being read.
pub struct Reader<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Checks magic and version.
    ///
    /// # Errors
    /// [`AttackError::NotANetwork`], [`AttackError::Version`].
    pub fn new(bytes: &'a [u8], format: &Format) -> Result<Self, AttackError> {
        if !bytes.starts_with(format.magic) {
            return Err(AttackError::NotANetwork { expected: format.expected });
        }
        let mut reader = Self { all: bytes, at: 8 };
        let found = reader.word()?;
        if found != format.version {
            return Err(AttackError::Version { found, expected: format.version });
        }
        Ok(reader)
    }

    /// Checks that so many bytes of head were read and `body` follow, and that all are those that were written.
    ///
    /// # Errors
    /// [`AttackError::Length`], [`AttackError::Checksum`].
    pub fn seal(&self, body: u64) -> Result<(), AttackError> {
        let expected = self.at as u64 + body + TAIL as u64;
        if self.all.len() as u64 != expected {
            return Err(AttackError::Length { found: self.all.len(), expected });
        }
        let (written, checksum) = self.all.split_at(self.all.len() - TAIL);
        if checksum == xxh3_64(written).to_le_bytes() { Ok(()) } else { Err(AttackError::Checksum) }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], AttackError> {
        let cut_short =
            AttackError::Length { found: self.all.len(), expected: (self.at.max(FRONT) + N + TAIL) as u64 };
        let some = self.all.get(self.at..self.at + N).ok_or(cut_short)?;
        self.at += N;
        Ok(some.try_into().expect("as many as were taken"))
    }

    /// The next small whole number.
    ///
    /// # Errors
    /// [`AttackError::Length`] where the file ends before.
    pub fn word(&mut self) -> Result<u32, AttackError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    /// The next text, what is no UTF-8 replaced. `what` names it in messages.
    ///
    /// # Errors
    /// [`AttackError`] where it is longer than any honest one, or the file ends before.
    pub fn text(&mut self, what: &'static str) -> Result<String, AttackError> {
        let length = self.word()? as usize;
        if length > LONGEST_TEXT {
            return Err(AttackError::refuse(what, length, "up to 1024"));
        }
        let mut text = Vec::new();
        while text.len() < length {
            text.extend(self.take::<4>()?);
        }
        text.truncate(length);
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    /// The next whole number.
    ///
    /// # Errors
    /// As [`Self::word`].
    pub fn long(&mut self) -> Result<u64, AttackError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    /// The next number.
    ///
    /// # Errors
    /// As [`Self::word`].
    pub fn real(&mut self) -> Result<f64, AttackError> {
        Ok(f64::from_bits(self.long()?))
    }

    /// So many numbers, finite ones. Only behind [`Self::seal`], which knows that they are there.
    ///
    /// # Errors
    /// [`AttackError::NotFinite`].
    pub fn numbers(&mut self, count: usize) -> Result<Vec<f32>, AttackError> {
        let mut numbers = Vec::with_capacity(count);
        for _ in 0..count {
            let number = f32::from_le_bytes(self.take()?);
            if !number.is_finite() {
                return Err(AttackError::NotFinite);
            }
            numbers.push(number);
        }
        Ok(numbers)
    }
}
