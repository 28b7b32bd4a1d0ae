//! How many bytes a text takes in the header compression of HTTP/2 (RFC 7541).

/// Bits of each printable character, from the space on (RFC 7541, appendix B).
const BITS: [u8; 95] = [
    6, 10, 10, 12, 13, 6, 8, 11, 10, 10, 8, 11, 8, 6, 6, 6, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 7, 8, 15, 6, 12,
    10, 13, 6, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 8, 7, 8, 13, 19, 13, 14, 6,
    15, 5, 6, 5, 6, 5, 6, 6, 6, 5, 7, 7, 6, 6, 6, 5, 6, 7, 6, 5, 5, 6, 7, 7, 7, 7, 7, 15, 11, 14, 13,
];

/// A character of exactly one byte, so that so many of it are so many bytes.
pub(crate) const BYTE: &str = "X";

/// Names of the static table (RFC 7541, appendix A) that responses may have: two bytes each where their values are not to be
/// remembered.
const STATIC: [&str; 47] = [
    "accept-charset",
    "accept-encoding",
    "accept-language",
    "accept-ranges",
    "accept",
    "access-control-allow-origin",
    "age",
    "allow",
    "authorization",
    "cache-control",
    "content-disposition",
    "content-encoding",
    "content-language",
    "content-length",
    "content-location",
    "content-range",
    "content-type",
    "cookie",
    "date",
    "etag",
    "expect",
    "expires",
    "from",
    "host",
    "if-match",
    "if-modified-since",
    "if-none-match",
    "if-range",
    "if-unmodified-since",
    "last-modified",
    "link",
    "location",
    "max-forwards",
    "proxy-authenticate",
    "proxy-authorization",
    "range",
    "referer",
    "refresh",
    "retry-after",
    "server",
    "set-cookie",
    "strict-transport-security",
    "transfer-encoding",
    "user-agent",
    "vary",
    "via",
    "www-authenticate",
];

/// A text with its length before it.
pub(crate) fn text(text: &[u8]) -> usize {
    // What is not printable has up to 30 bits; no header of ours holds any.
    let bits = |c: &u8| usize::from(*BITS.get(usize::from(c.wrapping_sub(b' '))).unwrap_or(&30));
    let bytes = text.iter().map(bits).sum::<usize>().div_ceil(8);
    bytes + length(bytes)
}

/// A number behind one bit (RFC 7541, 5.1).
fn length(number: usize) -> usize {
    let mut bytes = 1;
    if number >= 127 {
        bytes += 1;
        let mut rest = (number - 127) >> 7;
        while rest > 0 {
            bytes += 1;
            rest >>= 7;
        }
    }
    bytes
}

/// A header whose value is not to be remembered.
pub(crate) fn header(name: &str, value: &[u8]) -> usize {
    let name = if STATIC.contains(&name) { 2 } else { 1 + text(name.as_bytes()) };
    name + text(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of RFC 7541, C.4 and C.6.
    #[test]
    fn lengths_are_those_of_the_standard() {
        for (value, bytes) in [
            ("www.example.com", 1 + 12),
            ("no-cache", 1 + 6),
            ("custom-value", 1 + 9),
            ("302", 1 + 2),
            ("Mon, 21 Oct 2013 20:13:21 GMT", 1 + 22),
            ("https://www.example.com", 1 + 17),
            ("", 1),
        ] {
            assert_eq!(text(value.as_bytes()), bytes, "{value}");
        }
        for (count, bytes) in [(1, 2), (126, 127), (127, 129), (254, 256), (255, 258), (1000, 1003)] {
            assert_eq!(text(BYTE.repeat(count).as_bytes()), bytes, "{count}");
        }
    }
}
