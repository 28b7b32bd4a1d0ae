//! A web origin in the form that browsers send (`cors.rs`).

use std::fmt;
use std::str::FromStr;

use axum::http::HeaderValue;

/// Scheme, host and port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CorsOrigin(HeaderValue);

/// The text is not an allowed origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected https://HOST or https://HOST:PORT in lower case without a path (http:// only for localhost); `*` would \
     allow every page and is not supported"
)]
pub struct InvalidOrigin;

impl FromStr for CorsOrigin {
    type Err = InvalidOrigin;

    fn from_str(text: &str) -> Result<Self, InvalidOrigin> {
        let (scheme, authority) = text.split_once("://").ok_or(InvalidOrigin)?;
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !host.starts_with('[') || host.ends_with(']') => (host, Some(port)),
            _ => (authority, None),
        };
        let allowed = |c: u8| {
            c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, b'-' | b'.' | b'[' | b']' | b':')
        };
        let is_host = !host.is_empty() && host.bytes().all(allowed);
        // Browsers omit the default port of the scheme, so an origin that names it would never match.
        let is_port = port.is_none_or(|port| {
            port.parse::<u16>().is_ok_and(|n| n > 0 && n.to_string() == port)
                && !matches!((scheme, port), ("https", "443") | ("http", "80"))
        });
        let is_here = matches!(host, "localhost" | "127.0.0.1" | "[::1]");
        let is_scheme = scheme == "https" || scheme == "http" && is_here;
        if !(is_host && is_port && is_scheme) {
            return Err(InvalidOrigin);
        }
        HeaderValue::try_from(text).map(Self).map_err(|_| InvalidOrigin)
    }
}

impl CorsOrigin {
    /// Whether the `CorsOrigin` header has this value.
    pub(crate) fn is(&self, header: &HeaderValue) -> bool {
        self.0 == header
    }
}

impl From<CorsOrigin> for HeaderValue {
    fn from(origin: CorsOrigin) -> Self {
        origin.0
    }
}

impl fmt::Display for CorsOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.to_str().unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_parsed_in_browser_form() {
        for good in [
            "https://app.example",
            "https://app.example:8443",
            "https://xn--bcher-kva.example",
            "http://localhost:5173",
            "http://127.0.0.1:8000",
            "http://[::1]:8000",
            "https://[2001:db8::1]",
        ] {
            assert_eq!(good.parse::<CorsOrigin>().map(|origin| origin.to_string()).as_deref(), Ok(good));
        }
        for bad in [
            "*",
            "null",
            "",
            "app.example",
            "http://app.example",
            "https://",
            "https://*.example",
            "https://app.example/",
            "https://app.example:443",
            "http://localhost:80",
            "https://app.example:",
            "https://app.example:0",
            "https://app.example:99999",
            "https://App.example",
            "https://app.example, https://b.example",
            "https://user@app.example",
            "file://x",
        ] {
            assert_eq!(bad.parse::<CorsOrigin>(), Err(InvalidOrigin), "{bad}");
        }
    }
}
