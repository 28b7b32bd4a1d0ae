//! Error responses of a service (RFC 9457), without control characters.

use std::fmt;

use serde_json::Value;

/// An error response. All of its texts are [`printable`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// The HTTP status.
    pub status: u16,
    /// The problem type, as listed in `docs/reference/http.md`; empty when the service gave none.
    pub name: String,
    /// The short text of the problem type; empty when the service gave none.
    pub title: String,
    /// The cause in this case, and the remedy; empty when the service gave none.
    pub detail: String,
}

impl Refusal {
    /// From a response's status and body; any body is accepted.
    pub(crate) fn new(status: u16, body: &[u8]) -> Self {
        let document: Value = serde_json::from_slice(body).unwrap_or_default();
        let text = |field: &str| document[field].as_str().map(printable).unwrap_or_default();
        let kind = text("type");
        let name = kind.strip_prefix("urn:veiloc:problem:").unwrap_or_default().to_owned();
        Self { status, name, title: text("title"), detail: text("detail") }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { status, title, detail, .. } = self;
        if title.is_empty() || detail.is_empty() {
            return write!(f, "the service answered with status {status}");
        }
        write!(f, "{title} ({status}): {detail}")
    }
}

/// Text of the other side, safe for a terminal: at most 500 characters, without control characters, line breaks and
/// characters that change the writing direction.
pub fn printable(text: &str) -> String {
    let turns = |c: char| matches!(c, '\u{061C}' | '\u{200B}'..='\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2060}'..='\u{206F}' | '\u{FEFF}');
    text.chars().filter(|c| !c.is_control() && !turns(*c)).take(500).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printable_removes_control_characters() {
        assert_eq!(printable("a\u{1b}[2Jb\r\nc\u{9b}d\u{202e}e"), "a[2Jbcde");
        assert_eq!(printable(&"x".repeat(9000)).len(), 500);
    }

    #[test]
    fn any_body_gives_an_error_response() {
        for (body, expected) in [
            (&b""[..], "the service answered with status 500"),
            (b"<html>", "the service answered with status 500"),
            (b"[1, 2]", "the service answered with status 500"),
            (b"{\"title\": 7, \"detail\": {}}", "the service answered with status 500"),
            (b"{\"title\": \"A\", \"detail\": \"b\\u001b[2J\", \"type\": \"x\"}", "A (500): b[2J"),
        ] {
            let refusal = Refusal::new(500, body);
            assert_eq!((refusal.to_string().as_str(), refusal.name.as_str()), (expected, ""));
        }
        let body = b"{\"type\": \"urn:veiloc:problem:queue-full\"}";
        assert_eq!(Refusal::new(503, body).name, "queue-full");
    }
}
