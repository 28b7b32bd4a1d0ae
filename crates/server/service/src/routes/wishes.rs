//! What a caller may say beside a query, in headers of its own: none of it is needed, and all of it is checked.
//!
//! Headers and not the address: proxies write addresses into their logs.

use axum::http::{HeaderMap, HeaderName};
use veiloc_protocol::PositionHint;

use crate::problem::Problem;

/// `true` asks that doubtful poses be withheld.
pub(super) const TRUSTED_ONLY: HeaderName = HeaderName::from_static("veiloc-trusted-only");
/// Where the camera roughly is, `X,Y,Z,SD` in map units.
pub(super) const NEAR: HeaderName = HeaderName::from_static("veiloc-near");

/// What is wished for one request.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Wishes {
    /// A doubtful pose is withheld: the answer has its doubts and no pose.
    pub(super) trusted_only: bool,
    /// Where the camera roughly is.
    pub(super) near: Option<PositionHint>,
}

impl Wishes {
    /// Reads them. What is not understood is refused: whoever asked for trusted poses only must not get another one.
    pub(super) fn read(headers: &HeaderMap) -> Result<Self, Problem> {
        let trusted_only = match single(headers, &TRUSTED_ONLY) {
            Ok(None) => Some(false),
            Ok(Some(text)) => match text.trim() {
                "true" => Some(true),
                "false" => Some(false),
                _ => None,
            },
            Err(Twofold) => None,
        };
        let near = match single(headers, &NEAR) {
            Ok(None) => Some(None),
            Ok(Some(text)) => text.parse().ok().map(Some),
            Err(Twofold) => None,
        };
        Ok(Self {
            trusted_only: trusted_only.ok_or(Problem::BadWish("veiloc-trusted-only must be true or false"))?,
            near: near.ok_or(Problem::BadWish(
                "veiloc-near must be X,Y,Z,SD: four finite numbers in map units, the standard deviation SD above 0",
            ))?,
        })
    }
}

/// A header that came twice: whichever was meant, the other would be obeyed by somebody.
struct Twofold;

fn single<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, Twofold> {
    let mut values = headers.get_all(name).into_iter();
    match (values.next(), values.next()) {
        (None, _) => Ok(None),
        // Bytes that are no text are nobody's wish either.
        (Some(value), None) => Ok(Some(value.to_str().unwrap_or("?"))),
        (Some(_), Some(_)) => Err(Twofold),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(headers: &[(&str, &str)]) -> Result<Wishes, Problem> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            let name: HeaderName = name.parse().expect("a name");
            map.append(name, value.parse().expect("a value"));
        }
        Wishes::read(&map)
    }

    #[test]
    fn wishes_are_read_or_refused() {
        assert_eq!(read(&[]), Ok(Wishes::default()));
        assert_eq!(read(&[("veiloc-trusted-only", "false")]), Ok(Wishes::default()));
        let told =
            read(&[("Veiloc-Trusted-Only", "true"), ("veiloc-near", "1,2,-3.5,0.25")]).expect("wishes");
        let near = told.near.expect("told");
        assert_eq!((told.trusted_only, near.center(), near.sd()), (true, [1.0, 2.0, -3.5], 0.25));
        for bad in ["yes", "", "1", "TRUE", "true,true"] {
            assert!(matches!(read(&[("veiloc-trusted-only", bad)]), Err(Problem::BadWish(_))), "{bad}");
        }
        for bad in ["", "1,2,3", "1,2,3,0", "1,2,3,-1", "NaN,0,0,1", "1,2,3,inf", "a,b,c,d"] {
            assert!(matches!(read(&[("veiloc-near", bad)]), Err(Problem::BadWish(_))), "{bad}");
        }
        let twice = [("veiloc-trusted-only", "true"), ("veiloc-trusted-only", "false")];
        assert!(matches!(read(&twice), Err(Problem::BadWish(_))));
        let refused = read(&[("veiloc-near", "987,654,321,0")]).expect_err("refused").to_string();
        assert!(!refused.contains("987") && refused.contains("veiloc-near"), "{refused}");
    }
}
