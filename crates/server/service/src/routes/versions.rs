//! Cacheable content: `If-None-Match` and `Accept-Encoding` (RFC 9110).

use crate::http::problem::Problem;
use crate::web_page::Content;
use axum::http::header::{
    ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, ETAG, HeaderName, IF_MATCH, IF_NONE_MATCH, VARY,
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
    let etag = content.etag();
    // Without `Vary`, a cache could serve compressed content to a client that cannot decompress it.
    let vary = gzip.map(|_| [(VARY, ACCEPT_ENCODING.as_str())]);
    if matches_etag(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, vary, [(ETAG, etag)]).into_response();
    }
    (vary, encoding, [(ETAG, etag)], [(CONTENT_TYPE, content_type)], content.bytes().clone()).into_response()
}

/// Checks what a client demands of the current version, `None` if there is none, before it is changed: `If-Match` with its tag
/// or `*`, `If-None-Match: *`.
pub(super) fn precondition(headers: &HeaderMap, current: Option<&Content>) -> Result<(), Problem> {
    let etag = current.map(Content::etag);
    let is = |tag: &str| etag.as_deref().is_some_and(|etag| tag == "*" || tag == etag);
    let demanded = !headers.contains_key(IF_MATCH) || words(headers, IF_MATCH).any(is);
    let excluded = words(headers, IF_NONE_MATCH).any(is);
    (demanded && !excluded).then_some(()).ok_or(Problem::PreconditionFailed)
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
    fn preconditions_are_checked() {
        let content = Content::new("a");
        let own = format!("\"b\", {}", content.etag());
        for (name, tag, with_content, without) in [
            (IF_MATCH, own.as_str(), true, false),
            (IF_MATCH, "*", true, false),
            (IF_MATCH, "\"b\"", false, false),
            (IF_MATCH, "", false, false),
            (IF_NONE_MATCH, own.as_str(), false, true),
            (IF_NONE_MATCH, "*", false, true),
            (IF_NONE_MATCH, "\"b\"", true, true),
            (VARY, "*", true, true),
        ] {
            let headers = with(name.clone(), &[tag]);
            assert_eq!(precondition(&headers, Some(&content)).is_ok(), with_content, "{name} {tag}");
            assert_eq!(precondition(&headers, None).is_ok(), without, "{name} {tag}");
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
