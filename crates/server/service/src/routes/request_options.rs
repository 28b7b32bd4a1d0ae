//! Optional request headers of a query; each is validated.
//!
//! Headers are used instead of the address, because proxies log addresses.

use axum::http::{HeaderMap, HeaderName};
use veiloc_protocol::PositionHint;

use crate::auth::Lane;
use crate::http::problem::Problem;

/// `true` withholds doubtful poses.
pub(super) const TRUSTED_ONLY: HeaderName = HeaderName::from_static("veiloc-trusted-only");
/// From gateways: which client a query comes from, 64 hexadecimal digits.
const CLIENT: HeaderName = HeaderName::from_static("veiloc-client");
/// Prior of the camera position, `X,Y,Z,SD` in map units.
pub(super) const NEAR: HeaderName = HeaderName::from_static("veiloc-near");

/// The options of one request.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct RequestOptions {
    /// Withhold a doubtful pose: the answer then has the doubts but no pose.
    pub(super) trusted_only: bool,
    /// Prior of the camera position.
    pub(super) near: Option<PositionHint>,
    /// The client, if a gateway names it.
    pub(super) client: Option<Lane>,
}

/// The client that a gateway names.
pub(super) fn client(headers: &HeaderMap) -> Result<Option<Lane>, Problem> {
    let wrong = Problem::BadOption("veiloc-client must be 64 hexadecimal digits");
    match single(headers, &CLIENT) {
        Ok(None) => Ok(None),
        Ok(Some(text)) => Lane::of_hex(text).map(Some).ok_or(wrong),
        Err(Repeated) => Err(wrong),
    }
}

impl RequestOptions {
    /// Parses the headers. An invalid value is refused: a client that requested trusted poses only must never get
    /// another one.
    pub(super) fn read(headers: &HeaderMap) -> Result<Self, Problem> {
        let trusted_only = match single(headers, &TRUSTED_ONLY) {
            Ok(None) => Some(false),
            Ok(Some(text)) => match text.trim() {
                "true" => Some(true),
                "false" => Some(false),
                _ => None,
            },
            Err(Repeated) => None,
        };
        let near = match single(headers, &NEAR) {
            Ok(None) => Some(None),
            Ok(Some(text)) => text.parse().ok().map(Some),
            Err(Repeated) => None,
        };
        Ok(Self {
            trusted_only: trusted_only.ok_or(Problem::BadOption("veiloc-trusted-only must be true or false"))?,
            near: near.ok_or(Problem::BadOption(
                "veiloc-near must be X,Y,Z,SD: four finite numbers in map units, the standard deviation SD above 0",
            ))?,
            client: None,
        })
    }
}

/// The header was repeated, so its value is ambiguous.
struct Repeated;

fn single<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, Repeated> {
    let mut values = headers.get_all(name).into_iter();
    match (values.next(), values.next()) {
        (None, _) => Ok(None),
        // A value that is not text is invalid.
        (Some(value), None) => Ok(Some(value.to_str().unwrap_or("?"))),
        (Some(_), Some(_)) => Err(Repeated),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(headers: &[(&str, &str)]) -> Result<RequestOptions, Problem> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            let name: HeaderName = name.parse().expect("a name");
            map.append(name, value.parse().expect("a value"));
        }
        RequestOptions::read(&map)
    }

    #[test]
    fn options_are_parsed_or_refused() {
        assert_eq!(read(&[]), Ok(RequestOptions::default()));
        assert_eq!(read(&[("veiloc-trusted-only", "false")]), Ok(RequestOptions::default()));
        let options =
            read(&[("Veiloc-Trusted-Only", "true"), ("veiloc-near", "1,2,-3.5,0.25")]).expect("options");
        let near = options.near.expect("near");
        assert_eq!((options.trusted_only, near.center(), near.sd()), (true, [1.0, 2.0, -3.5], 0.25));
        for bad in ["yes", "", "1", "TRUE", "true,true"] {
            assert!(matches!(read(&[("veiloc-trusted-only", bad)]), Err(Problem::BadOption(_))), "{bad}");
        }
        for bad in ["", "1,2,3", "1,2,3,0", "1,2,3,-1", "NaN,0,0,1", "1,2,3,inf", "a,b,c,d"] {
            assert!(matches!(read(&[("veiloc-near", bad)]), Err(Problem::BadOption(_))), "{bad}");
        }
        let twice = [("veiloc-trusted-only", "true"), ("veiloc-trusted-only", "false")];
        assert!(matches!(read(&twice), Err(Problem::BadOption(_))));
        let refused = read(&[("veiloc-near", "987,654,321,0")]).expect_err("refused").to_string();
        assert!(!refused.contains("987") && refused.contains("veiloc-near"), "{refused}");
    }
}
