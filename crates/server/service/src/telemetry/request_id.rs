//! Request ids: 128 random bits drawn by the server.
//!
//! An id sent by the client is never used: it would bring client text into the log, and would let a reader of the log
//! link requests. A counter would reveal the number of requests to every client. The id has the form of a trace id
//! (W3C Trace Context), so log, answer and trace share one id.

use std::fmt;
use std::io;
use std::sync::{Mutex, PoisonError};

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{RngCore as _, SeedableRng as _};

/// The id of a request, printed as exactly 32 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RequestId([u8; 16]);

impl RequestId {
    /// The id of a request that another machine drew.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// The id as bytes.
    pub const fn bytes(&self) -> [u8; 16] {
        self.0
    }

    /// The id of a span of the request: 0 is the request itself. Spans of this machine have numbers below 2^40.
    pub const fn span(&self, number: u64) -> SpanId {
        let [_, _, _, _, _, _, _, _, low @ ..] = self.0;
        // Never 0, and adding the number cannot overflow.
        SpanId((u64::from_be_bytes(low) >> 1 | 1 << 62).wrapping_add(number))
    }
}

/// The id of a span of a trace, printed as 16 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SpanId(u64);

impl SpanId {
    /// From its number; `None` for 0, which is not a valid id.
    pub const fn from_number(number: u64) -> Option<Self> {
        if number == 0 { None } else { Some(Self(number)) }
    }

    /// As a number.
    pub const fn number(self) -> u64 {
        self.0
    }

    /// The id of a span of another machine within this one: 0 is its work as a whole. It differs from those of the
    /// machine that sent the request.
    pub const fn within(self, number: u64) -> Self {
        Self(self.0.wrapping_add((number + 1) << 40))
    }
}

impl fmt::Display for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl fmt::Display for RequestId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(self.0))
    }
}

/// Source of ids: a cryptographic generator, seeded once by the system, so that no request can fail for lack of
/// randomness.
#[derive(Debug)]
pub struct RequestIds(Mutex<ChaCha20Rng>);

impl RequestIds {
    /// A generator with a fresh seed.
    ///
    /// # Errors
    /// The system has no randomness.
    pub fn start() -> io::Result<Self> {
        let mut seed = [0; 32];
        getrandom::fill(&mut seed).map_err(|error| io::Error::other(error.to_string()))?;
        Ok(Self(Mutex::new(ChaCha20Rng::from_seed(seed))))
    }

    /// The next id; never all zeros, which is not a valid trace id.
    #[allow(clippy::should_implement_trait)] // an endless iterator that is shared would be odd
    pub fn next(&self) -> RequestId {
        let mut bytes = [0; 16];
        let mut generator = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        while bytes == [0; 16] {
            generator.fill_bytes(&mut bytes);
        }
        RequestId(bytes)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn ids_are_unique_and_of_fixed_length() {
        let (first, second) = (RequestIds::start().expect("random"), RequestIds::start().expect("random"));
        let all: HashSet<String> =
            (0..1000).flat_map(|_| [first.next(), second.next()]).map(|id| id.to_string()).collect();
        assert_eq!(all.len(), 2000);
        let hex = |id: &String| id.len() == 32 && id.bytes().all(|c| b"0123456789abcdef".contains(&c));
        assert!(all.iter().all(hex));
        assert_eq!(RequestId([0x0A; 16]).to_string(), "0a".repeat(16));
    }
}
