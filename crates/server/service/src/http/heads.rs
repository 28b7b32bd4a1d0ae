//! Rule L12 on HTTP/2: how long a head is does not tell what it says.
//!
//! Header compression makes a head as long as what it says, and shorter when it says the same again. So of a reply that
//! is to be of one length nothing is remembered (every value is marked as sensitive, RFC 7541, 7.1.3), its length is worked
//! out, and the header `padding` fills it up. A status that is not in the standard's table cannot be marked: it takes four or
//! five bytes the first time on a connection and one from then on, which is counted along.
//! `veiloc-service`'s `tests/http2.rs` measures it on the wire.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use hyper::header::{CONTENT_LENGTH, DATE, HeaderName, HeaderValue};
use hyper::{Response, body::Body};

use crate::http::huffman::{BYTE, header, text};

/// Travels with a response: how long its head is to be, in a measure of the sender's. All heads of one number have one
/// length on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HeadBytes(pub usize);

/// Added to what was asked for, so that there always is room for the padding, and its length is written in three bytes.
const ROOM: usize = 768;

const PADDING: HeaderName = HeaderName::from_static("padding");

/// Statuses that the standard's table holds.
const KNOWN: [u16; 7] = [200, 204, 206, 304, 400, 404, 500];

/// The heads of one connection.
#[derive(Default)]
pub(crate) struct Heads {
    /// Other statuses that were sent on it.
    sent: Mutex<BTreeSet<u16>>,
}

impl Heads {
    /// Adds the date, and fills up what is to be filled up.
    pub(crate) fn fill<B: Body>(&self, response: &mut Response<B>) {
        let date = httpdate::fmt_http_date(SystemTime::now());
        if let Ok(date) = HeaderValue::try_from(date) {
            response.headers_mut().entry(DATE).or_insert(date);
        }
        let status = response.status().as_u16();
        let is_new = self.sent.lock().unwrap_or_else(PoisonError::into_inner).insert(status);
        let Some(HeadBytes(wanted)) = response.extensions().get::<HeadBytes>().copied() else { return };
        let is_indexed = KNOWN.contains(&status) || !is_new;
        let status = if is_indexed { 1 } else { 1 + text(response.status().as_str().as_bytes()) };
        if let Some(length) = response.body().size_hint().exact() {
            response.headers_mut().insert(CONTENT_LENGTH, length.into());
        }
        // It has no place here, and hyper would take it out.
        response.headers_mut().remove(hyper::header::CONNECTION);
        response.headers_mut().remove(PADDING);
        for value in response.headers_mut().values_mut() {
            value.set_sensitive(true);
        }
        let others: usize =
            response.headers().iter().map(|(name, value)| header(name.as_str(), value.as_bytes())).sum();
        let room = (wanted + ROOM).saturating_sub(status + others + header(PADDING.as_str(), b"") - 1);
        // Three bytes of it say how long it is.
        if let Ok(mut padding) = HeaderValue::try_from(BYTE.repeat(room.saturating_sub(3))) {
            padding.set_sensitive(true);
            response.headers_mut().insert(PADDING, padding);
        }
    }
}
