//! Format of messages between loader and library: a JSON head, then a payload of bytes.
//!
//! ```text
//! 4 bytes   length of the head, little endian
//! N bytes   head, JSON
//! …         payload: pixels, a profile, a query, or numbers that the head describes
//! ```

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::WebError;

/// Most bytes of a head.
const MAX_HEAD_BYTES: usize = 64 << 10;

/// Reads head and payload of a message.
///
/// # Errors
/// [`WebError::Request`] when the message is truncated, or its head is not of this type.
pub fn read<T: DeserializeOwned>(message: &[u8]) -> Result<(T, &[u8]), WebError> {
    let short = || WebError::Request { reason: "the message is truncated".to_owned() };
    let (length, rest) = message.split_first_chunk::<4>().ok_or_else(short)?;
    let length = u32::from_le_bytes(*length) as usize;
    let head = rest.get(..length).filter(|_| length <= MAX_HEAD_BYTES).ok_or_else(short)?;
    let head = serde_json::from_slice(head).map_err(|e| WebError::Request { reason: e.to_string() })?;
    Ok((head, &rest[length..]))
}

/// Writes a message of head and payload.
pub fn write(head: &impl Serialize, bytes: &[u8]) -> Vec<u8> {
    // Heads are structs of numbers and strings, which always serialize.
    let head = serde_json::to_vec(head).unwrap_or_default();
    let mut message = Vec::with_capacity(4 + head.len() + bytes.len());
    message.extend_from_slice(&(head.len() as u32).to_le_bytes());
    message.extend_from_slice(&head);
    message.extend_from_slice(bytes);
    message
}

/// Numbers in the byte order of a `Float32Array`.
pub fn floats(numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    numbers.into_iter().flat_map(|number| (number as f32).to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn messages_round_trip() {
        let message = write(&json!({"a": 1}), &[7, 8]);
        let (head, bytes): (Value, _) = read(&message).expect("whole");
        assert_eq!((head, bytes), (json!({"a": 1}), &[7, 8][..]));
        for cut in 0..message.len() - 2 {
            assert!(read::<Value>(&message[..cut]).is_err(), "{cut}");
        }
        assert!(read::<Value>(&[0xFF; 100]).is_err(), "a head of 4 GB");
    }
}
