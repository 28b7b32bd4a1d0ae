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

use crate::error::NetworkError;

/// What a file is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Format {
    pub(crate) magic: &'static [u8; 8],
    pub(crate) version: u32,
    /// For the message where it is none.
    pub(crate) expected: &'static str,
}

/// Bytes behind the body.
const TAIL: usize = 8;
/// Bytes before the head.
const FRONT: usize = 12;

/// Bytes being written.
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    pub(crate) fn new(format: &Format) -> Self {
        let mut bytes = format.magic.to_vec();
        bytes.extend(format.version.to_le_bytes());
        Self(bytes)
    }

    pub(crate) fn words(&mut self, words: &[u32]) {
        self.0.extend(words.iter().flat_map(|w| w.to_le_bytes()));
    }

    pub(crate) fn long(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    pub(crate) fn real(&mut self, number: f64) {
        self.long(number.to_bits());
    }

    pub(crate) fn numbers(&mut self, numbers: &[f32]) {
        self.0.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    }

    /// With the checksum behind.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        let checksum = xxh3_64(&self.0);
        self.long(checksum);
        self.0
    }
}

/// Bytes being read.
pub(crate) struct Reader<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Checks magic and version.
    pub(crate) fn new(bytes: &'a [u8], format: &Format) -> Result<Self, NetworkError> {
        if !bytes.starts_with(format.magic) {
            return Err(NetworkError::NotANetwork { expected: format.expected });
        }
        let mut reader = Self { all: bytes, at: 8 };
        let found = reader.word()?;
        if found != format.version {
            return Err(NetworkError::Version { found, expected: format.version });
        }
        Ok(reader)
    }

    /// Checks that so many bytes of head were read and `body` follow, and that all are those that were written.
    pub(crate) fn seal(&self, body: u64) -> Result<(), NetworkError> {
        let expected = self.at as u64 + body + TAIL as u64;
        if self.all.len() as u64 != expected {
            return Err(NetworkError::Length { found: self.all.len(), expected });
        }
        let (written, checksum) = self.all.split_at(self.all.len() - TAIL);
        if checksum == xxh3_64(written).to_le_bytes() { Ok(()) } else { Err(NetworkError::Checksum) }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], NetworkError> {
        let cut_short =
            NetworkError::Length { found: self.all.len(), expected: (self.at.max(FRONT) + N + TAIL) as u64 };
        let some = self.all.get(self.at..self.at + N).ok_or(cut_short)?;
        self.at += N;
        Ok(some.try_into().expect("as many as were taken"))
    }

    pub(crate) fn word(&mut self) -> Result<u32, NetworkError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    pub(crate) fn long(&mut self) -> Result<u64, NetworkError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    pub(crate) fn real(&mut self) -> Result<f64, NetworkError> {
        Ok(f64::from_bits(self.long()?))
    }

    /// So many numbers, finite ones. Only behind [`Self::seal`], which knows that they are there.
    pub(crate) fn numbers(&mut self, count: usize) -> Result<Vec<f32>, NetworkError> {
        let mut numbers = Vec::with_capacity(count);
        for _ in 0..count {
            let number = f32::from_le_bytes(self.take()?);
            if !number.is_finite() {
                return Err(NetworkError::NotFinite);
            }
            numbers.push(number);
        }
        Ok(numbers)
    }
}
