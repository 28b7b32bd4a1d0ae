//! Cacheable content: `If-None-Match` and `Accept-Encoding` (RFC 9110).

use crate::web_page::Content;
use axum::http::header::{
    ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, ETAG, HeaderName, IF_NONE_MATCH, VARY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse as _, Response};

/// Responds with 304 if the client has the current version, else with the content, compressed if possible and
/// accepted. The compressed form has a strong tag of its own.
pub(super) fn version(
    plain: &Content,
    gzip: Option<&Content>,
    content_type: &'static str,
    headers: &HeaderMap,
) -> Response {
    let (content, encoding) = match gzip.filter(|_| accepts_gzip(headers)) {
        Some(gzip) => (gzip, Some([(CONTENT_ENCODING, "gzip")])),
        None => (plain, None),
    };
    let etag = format!("\"{}\"", content.hash());
    // Without `Vary`, a cache could serve compressed content to a client that cannot decompress it.
    let vary = gzip.map(|_| [(VARY, ACCEPT_ENCODING.as_str())]);
    if matches_etag(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, vary, [(ETAG, etag)]).into_response();
    }
    (vary, encoding, [(ETAG, etag)], [(CONTENT_TYPE, content_type)], content.bytes().clone()).into_response()
}

/// Whether the client has this version.
fn matches_etag(headers: &HeaderMap, etag: &str) -> bool {
    let mut tags = words(headers, IF_NONE_MATCH);
    tags.any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag)
}

/// Whether the client explicitly accepts gzip.
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let mut by_name = None;
    let mut by_star = None;
    for word in words(headers, ACCEPT_ENCODING) {
        let (coding, weight) = word.split_once(';').unwrap_or((word, ""));
        let weight = weight.trim().to_ascii_lowercase();
        // An invalid weight does not count as accepting.
        let is_accepted = weight.is_empty()
            || weight.strip_prefix("q=").is_some_and(|q| q.parse().is_ok_and(|q: f32| q > 0.0));
        match coding.trim().to_ascii_lowercase().as_str() {
            "gzip" | "x-gzip" => by_name = Some(is_accepted),
            "*" => by_star = Some(is_accepted),
            _ => {}
        }
    }
    by_name.or(by_star).unwrap_or(false)
}

/// The list elements of a header, of all its lines.
fn words(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let values = headers.get_all(name).into_iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: HeaderName, lines: &[&str]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(&name, line.parse().expect("a value"));
        }
        headers
    }

    #[test]
    fn gzip_is_negotiated() {
        for (lines, takes) in [
            (&[][..], false),
            (&[""], false),
            (&["gzip"], true),
            (&["x-gzip"], true),
            (&["deflate, GZIP;q=0.5, br"], true),
            (&["br", "gzip ; Q=1.0"], true),
            (&["gzip;q=0"], false),
            (&["gzip; q=0.000, *"], false),
            (&["*"], true),
            (&["*;q=0"], false),
            (&["*;q=0, gzip"], true),
            (&["identity"], false),
            (&["gzip;q=much"], false),
            (&["gzippy"], false),
        ] {
            assert_eq!(accepts_gzip(&with(ACCEPT_ENCODING, lines)), takes, "{lines:?}");
        }
    }

    #[test]
    fn etags_are_matched() {
        for (lines, known) in [
            (&[][..], false),
            (&["\"a\""], true),
            (&["W/\"a\""], true),
            (&["\"b\", \"a\""], true),
            (&["\"b\"", "\"a\""], true),
            (&["*"], true),
            (&["a"], false),
            (&["\"ab\""], false),
        ] {
            assert_eq!(matches_etag(&with(IF_NONE_MATCH, lines), "\"a\""), known, "{lines:?}");
        }
    }
}
