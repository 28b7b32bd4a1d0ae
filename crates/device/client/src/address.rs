//! The address of a service, checked once before anything is sent.

use ureq::http::Uri;
use veiloc_protocol::is_map_name;

use crate::ClientError;

/// Address of a service, without a trailing slash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Address {
    /// Prefix of all paths.
    pub(crate) base: String,
    /// Plain HTTP to this machine: no proxy may be used.
    pub(crate) is_local: bool,
}

impl Address {
    /// HTTPS, or plain HTTP to this machine or when `insecure_http` allows it.
    pub(crate) fn new(server: &str, insecure_http: bool) -> Result<Self, ClientError> {
        let base = server.trim_end_matches('/').to_owned();
        let bad = |reason| ClientError::Address { address: base.clone(), reason };
        // Parsed as the transport parses it: another parser could find another host, and the query would be sent there.
        let uri: Uri =
            base.parse().map_err(|_| bad("is not the address of a service; begin it with https://"))?;
        let host = uri.host().filter(|host| !host.is_empty());
        let Some(host) = host else {
            return Err(bad("is not the address of a service; begin it with https://"));
        };
        if uri.query().is_some() || base.contains('#') {
            return Err(bad("has a query or a fragment; give scheme, host, port and path"));
        }
        if uri.authority().is_some_and(|authority| authority.as_str().contains('@')) {
            return Err(bad("contains a user name; authenticate with a token instead"));
        }
        let is_loopback = is_loopback(host);
        match uri.scheme_str() {
            Some("https") => Ok(Self { base, is_local: false }),
            Some("http") if is_loopback || insecure_http => Ok(Self { base, is_local: is_loopback }),
            Some("http") => Err(ClientError::PlainHttp { address: base }),
            _ => Err(bad("is not the address of a service; begin it with https://")),
        }
    }

    /// The address of a map's resource.
    pub(crate) fn of_map(&self, map: &str, resource: &str) -> Result<String, ClientError> {
        if !is_map_name(map) {
            return Err(ClientError::MapName { name: map.to_owned() });
        }
        Ok(format!("{}/v1/maps/{map}/{resource}", self.base))
    }
}

fn is_loopback(host: &str) -> bool {
    let host = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// A token as it goes into a header; `None` when it is empty.
pub(crate) fn token(token: Option<&str>) -> Result<Option<String>, ClientError> {
    let token = token.map(str::trim).filter(|token| !token.is_empty());
    if token.is_some_and(|t| !t.chars().all(|c| c.is_ascii_graphic())) {
        return Err(ClientError::Token);
    }
    Ok(token.map(str::to_owned))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_http_is_limited_to_loopback() {
        for ours in ["localhost", "localhost:80", "127.0.0.1:8080/x", "[::1]:80", "127.9.9.9"] {
            let address = Address::new(&format!("http://{ours}/"), false).expect(ours);
            assert!(address.is_local && !address.base.ends_with('/'), "{address:?}");
        }
        for other in ["example.org", "localhost.example.org", "10.0.0.1", "[::2]:80"] {
            let plain = format!("http://{other}");
            assert!(matches!(Address::new(&plain, false), Err(ClientError::PlainHttp { .. })), "{other}");
            assert!(!Address::new(&plain, true).expect("allowed").is_local, "{other}");
            Address::new(&format!("https://{other}"), false).expect("over TLS");
        }
        // Forms that different parsers may read as different hosts.
        for no_address in [
            "localhost",
            "",
            "http://",
            "https://",
            "ftp://localhost",
            "http://localhost@evil.example",
            "http://evil.example?@localhost",
            "http://evil.example#@localhost",
            "http://evil.example\\@localhost",
            "https://user:secret@places.example",
            "https://places.example/?a=b",
        ] {
            assert!(Address::new(no_address, false).is_err(), "{no_address}");
            assert!(Address::new(no_address, true).is_err(), "{no_address}, plain HTTP allowed");
        }
    }

    #[test]
    fn map_names_cannot_change_the_path() {
        let address = Address::new("https://places.example/veiloc", false).expect("an address");
        let url = address.of_map("lobby-2.b_x", "localize").expect("a name");
        assert_eq!(url, "https://places.example/veiloc/v1/maps/lobby-2.b_x/localize");
        for bad in ["", ".", "..", "a/b", "a?b", "a%2Fb", "ä", "a b", "a\r\nb", &"x".repeat(65)] {
            assert!(matches!(address.of_map(bad, "localize"), Err(ClientError::MapName { .. })), "{bad:?}");
        }
    }

    #[test]
    fn tokens_have_no_whitespace() {
        assert_eq!(token(Some(" abc\n")).expect("a token").as_deref(), Some("abc"));
        assert_eq!(token(Some(" \n")).expect("none"), None);
        for bad in ["a b", "a\r\nx: y", "ä"] {
            assert!(matches!(token(Some(bad)), Err(ClientError::Token)), "{bad:?}");
        }
    }
}
