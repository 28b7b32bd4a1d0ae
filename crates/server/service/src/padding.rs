//! Rule L12: how long a reply is does not tell what it says, also to who counts bytes outside TLS.
//!
//! Bodies are filled up to a whole number of [`BODY_UNIT`]: JSON with spaces, protobuf with a field of its own
//! (`veiloc_protocol::Answer::encode`). What is left are the few bytes by which status lines and headers differ; a header
//! fills these up, see [`fill_head`].
//! `tests/lengths.rs` measures both on the wire, over TLS too.

use axum::body::HttpBody as _;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH};
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use veiloc_protocol::Answer;

/// Padded bodies have a whole number of times so many bytes: once, for everything this service says.
pub(crate) const BODY_UNIT: usize = Answer::PADDED_BYTES;
/// Head and padded body together: so many bytes more than a whole number of this.
const HEAD_UNIT: usize = 512;
/// The header that fills up the head. Clients take no notice of it.
const PADDING: HeaderName = HeaderName::from_static("padding");

/// Travels with a response whose length is hidden: the body is padded, and the head is to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Hidden;

/// JSON with spaces behind it, and a line's end.
pub(crate) fn json(mut body: Vec<u8>) -> Vec<u8> {
    let length = (body.len() + 1).next_multiple_of(BODY_UNIT);
    body.resize(length - 1, b' ');
    body.push(b'\n');
    body
}

/// Fills up the head of a reply that is marked as [`Hidden`]; others pass. To be called when all headers are there.
pub(crate) fn fill_head(mut response: Response) -> Response {
    if response.extensions().get::<Hidden>().is_none() {
        return response;
    }
    // A proxy that compresses would undo it all.
    response.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store, no-transform"));
    let body = response.size_hint().exact().unwrap_or_default() as usize;
    let head = head_length(&response, body) + PADDING.as_str().len() + HEADER_FRAME;
    let missing = head.next_multiple_of(HEAD_UNIT) - head;
    // Zeros are a header's value.
    if let Ok(value) = HeaderValue::try_from("0".repeat(missing)) {
        response.headers_mut().insert(PADDING, value);
    }
    response
}

/// `: ` and the line's end.
const HEADER_FRAME: usize = 4;

/// Bytes of the head that depend on what is said. Left out are those that do not: the date, `HTTP/1.1`, line's ends.
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
    fn json_is_filled_up_and_still_json() {
        for length in [2, 100, BODY_UNIT - 1, BODY_UNIT, BODY_UNIT + 1] {
            let text = format!("\"{}\"", "x".repeat(length - 2));
            let padded = json(text.clone().into_bytes());
            assert_eq!(padded.len(), if length < BODY_UNIT { BODY_UNIT } else { 2 * BODY_UNIT });
            let read: String = serde_json::from_slice(&padded).expect("JSON");
            assert_eq!(format!("{read:?}"), text);
        }
    }

    #[test]
    fn heads_are_filled_up() {
        let total = |response: &Response| {
            let body = response.size_hint().exact().expect("known") as usize;
            head_length(response, body) + body
        };
        for status in [StatusCode::OK, StatusCode::UNPROCESSABLE_ENTITY] {
            let mut response = (status, vec![0_u8; BODY_UNIT]).into_response();
            response.extensions_mut().insert(Hidden);
            assert_eq!(total(&fill_head(response)), BODY_UNIT + HEAD_UNIT, "{status}");
        }
        let other = fill_head("alive".into_response());
        assert!(other.headers().get(PADDING).is_none(), "what is no reply to a query is left alone");
    }
}
