//! Rule L12: the length of a response reveals nothing about its content, also to an observer of the encrypted
//! connection.
//!
//! Bodies are padded to a multiple of [`BODY_UNIT`]: JSON with spaces, protobuf with a padding field
//! (`veiloc_protocol::Answer::encode`). Status lines and headers differ by a few bytes; a padding header hides these,
//! see [`pad_head`]. `tests/it/lengths.rs` measures both on the wire, with and without TLS.

use axum::body::HttpBody as _;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH};
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use veiloc_protocol::Answer;

/// Lengths of padded bodies are multiples of this; every body of this service fits into one unit.
pub(crate) const BODY_UNIT: usize = Answer::PADDED_BYTES;
/// The head is padded to a multiple of this.
const HEAD_UNIT: usize = 512;
/// The header that pads the head. Clients ignore it.
const PADDING: HeaderName = HeaderName::from_static("padding");

/// Response extension that marks a response whose length must be hidden: its body is padded already, its head must
/// be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PadLength;

/// Pads JSON with spaces and appends a newline.
pub(crate) fn json(mut body: Vec<u8>) -> Vec<u8> {
    let length = (body.len() + 1).next_multiple_of(BODY_UNIT);
    body.resize(length - 1, b' ');
    body.push(b'\n');
    body
}

/// Pads the head of a response marked with [`PadLength`]; returns others unchanged. Must run after all headers are
/// set.
pub(crate) fn pad_head(mut response: Response) -> Response {
    if response.extensions().get::<PadLength>().is_none() {
        return response;
    }
    // A proxy that compresses would undo the padding.
    response.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store, no-transform"));
    let body = response.size_hint().exact().unwrap_or_default() as usize;
    let head = head_length(&response, body) + PADDING.as_str().len() + HEADER_FRAME;
    let missing = head.next_multiple_of(HEAD_UNIT) - head;
    // Zeros are a valid header value.
    if let Ok(value) = HeaderValue::try_from("0".repeat(missing)) {
        response.headers_mut().insert(PADDING, value);
    }
    response
}

/// `: ` and the end of the line.
const HEADER_FRAME: usize = 4;

/// Bytes of the head that depend on the content. The date, `HTTP/1.1` and line ends are left out because their length
/// is constant.
fn head_length(response: &Response, body: usize) -> usize {
    let reason = response.status().canonical_reason().unwrap_or_default().len();
    let own = response.headers().iter().filter(|(name, _)| *name != CONTENT_LENGTH);
    let headers: usize = own.map(|(name, value)| name.as_str().len() + value.len() + HEADER_FRAME).sum();
    reason + headers + body.to_string().len()
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;
    use axum::response::IntoResponse as _;

    use super::*;

    #[test]
    fn padded_json_is_valid_json() {
        for length in [2, 100, BODY_UNIT - 1, BODY_UNIT, BODY_UNIT + 1] {
            let text = format!("\"{}\"", "x".repeat(length - 2));
            let padded = json(text.clone().into_bytes());
            assert_eq!(padded.len(), if length < BODY_UNIT { BODY_UNIT } else { 2 * BODY_UNIT });
            let read: String = serde_json::from_slice(&padded).expect("JSON");
            assert_eq!(format!("{read:?}"), text);
        }
    }

    #[test]
    fn heads_are_padded() {
        let total = |response: &Response| {
            let body = response.size_hint().exact().expect("known") as usize;
            head_length(response, body) + body
        };
        for status in [StatusCode::OK, StatusCode::UNPROCESSABLE_ENTITY] {
            let mut response = (status, vec![0_u8; BODY_UNIT]).into_response();
            response.extensions_mut().insert(PadLength);
            assert_eq!(total(&pad_head(response)), BODY_UNIT + HEAD_UNIT, "{status}");
        }
        let other = pad_head("alive".into_response());
        assert!(other.headers().get(PADDING).is_none(), "only responses to queries are padded");
    }
}
