//! Which form of answer a client gets: `Accept` (RFC 9110, 12.5.1) against what a map can be answered in.

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;
use veiloc_protocol::AnswerVersion;

/// A form of answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    Json,
    Protobuf(AnswerVersion),
}

impl Form {
    /// All forms, the one that is given when the client has no wish first.
    const ALL: [Self; 4] = [
        Self::Json,
        Self::Protobuf(AnswerVersion::Full),
        Self::Protobuf(AnswerVersion::Padded),
        Self::Protobuf(AnswerVersion::Plain),
    ];

    /// What a query can be answered in, given whether the form must be able to withhold a pose.
    pub(super) fn offered(withholding: bool) -> impl Iterator<Item = Self> + Clone {
        Self::ALL.into_iter().filter(move |form| !withholding || form.can_withhold())
    }

    /// Whether it has a way to say that a pose was found and is not told.
    const fn can_withhold(self) -> bool {
        match self {
            Self::Json | Self::Protobuf(AnswerVersion::Full) => true,
            Self::Protobuf(AnswerVersion::Plain | AnswerVersion::Padded) => false,
        }
    }

    pub(super) const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Protobuf(AnswerVersion::Plain) => "application/x-protobuf",
            Self::Protobuf(AnswerVersion::Padded) => "application/x-protobuf;version=2",
            Self::Protobuf(AnswerVersion::Full) => "application/x-protobuf;version=3",
        }
    }

    /// Type without parameters, and version where there are several.
    const fn media(self) -> (&'static str, Option<&'static str>) {
        match self {
            Self::Json => ("application/json", None),
            Self::Protobuf(AnswerVersion::Plain) => ("application/x-protobuf", Some("1")),
            Self::Protobuf(AnswerVersion::Padded) => ("application/x-protobuf", Some("2")),
            Self::Protobuf(AnswerVersion::Full) => ("application/x-protobuf", Some("3")),
        }
    }

    /// The offered form the client likes best: of the greatest weight, then as exactly named as possible, then the first
    /// it names, then the first offered.
    ///
    /// A client that takes none of our forms gets JSON, which the standard allows.
    pub(super) fn negotiate(headers: &HeaderMap, offered: impl Iterator<Item = Self>) -> Self {
        let ranges = ranges(headers);
        let mut best: Option<(Wish, Self)> = None;
        for form in offered {
            let Some(wish) = wish(&ranges, form).filter(|wish| wish.thousandths > 0) else { continue };
            if best.is_none_or(|(other, _)| wish.is_stronger_than(other)) {
                best = Some((wish, form));
            }
        }
        best.map_or(Self::Json, |(_, form)| form)
    }
}

/// A media range and its weight.
struct Range {
    name: String,
    version: Option<String>,
    thousandths: u32,
}

/// How much a form is wanted.
#[derive(Debug, Clone, Copy)]
struct Wish {
    thousandths: u32,
    exactness: u8,
    index: usize,
}

impl Wish {
    fn is_stronger_than(self, other: Self) -> bool {
        let key = |wish: Self| (wish.thousandths, wish.exactness, std::cmp::Reverse(wish.index));
        key(self) > key(other)
    }
}

fn ranges(headers: &HeaderMap) -> Vec<Range> {
    let values = headers.get_all(ACCEPT).into_iter();
    values.flat_map(|value| value.to_str().unwrap_or_default().split(',')).map(range).collect()
}

fn range(text: &str) -> Range {
    let mut parts = text.split(';').map(str::trim);
    let name = parts.next().unwrap_or_default().to_ascii_lowercase();
    let mut range = Range { name, version: None, thousandths: 1000 };
    for (key, value) in parts.filter_map(|part| part.split_once('=')) {
        match key.trim().to_ascii_lowercase().as_str() {
            "q" => range.thousandths = thousandths(value.trim()),
            "version" => range.version = Some(value.trim().trim_matches('"').to_owned()),
            _ => {}
        }
    }
    range
}

/// The most exact range that a form falls into decides, the first of equals; `None` when it falls into none.
fn wish(ranges: &[Range], form: Form) -> Option<Wish> {
    let (name, version) = form.media();
    let exactness = |range: &Range| match range.name.as_str() {
        "*/*" => Some(0),
        "application/*" => Some(1),
        // Clients that know of no versions read version 1 only.
        other if other == name && version.is_none_or(|v| v == range.version.as_deref().unwrap_or("1")) => {
            Some(2)
        }
        _ => None,
    };
    let mut best: Option<Wish> = None;
    for (index, range) in ranges.iter().enumerate() {
        let Some(exactness) = exactness(range) else { continue };
        if best.is_none_or(|wish| exactness > wish.exactness) {
            best = Some(Wish { thousandths: range.thousandths, exactness, index });
        }
    }
    best
}

/// A weight between 0 and 1 as HTTP writes it, in thousandths; nonsense counts as no wish.
fn thousandths(text: &str) -> u32 {
    text.parse::<f32>().ok().filter(|q| (0.0..=1.0).contains(q)).map_or(0, |q| (q * 1000.0).round() as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Form = Form::Protobuf(AnswerVersion::Plain);
    const PADDED: Form = Form::Protobuf(AnswerVersion::Padded);
    const FULL: Form = Form::Protobuf(AnswerVersion::Full);

    #[test]
    fn the_best_form_that_can_be_given_is_given() {
        // Asked for, answered.
        for (accept, given) in [
            ("", Form::Json),
            ("*/*", Form::Json),
            ("application/*", Form::Json),
            ("text/html", Form::Json),
            ("text/html, */*;q=0.1", Form::Json),
            ("application/x-protobuf", PLAIN),
            ("Application/X-Protobuf", PLAIN),
            ("application/x-protobuf;version=1", PLAIN),
            ("application/x-protobuf;version=2", PADDED),
            ("application/x-protobuf; Version=\"2\"", PADDED),
            ("application/x-protobuf;version=2, application/x-protobuf;q=0.5", PADDED),
            ("application/x-protobuf;version=3", FULL),
            ("application/x-protobuf;version=3, application/x-protobuf;version=2;q=0.5", FULL),
            ("application/x-protobuf;version=4, application/x-protobuf;q=0.5", PLAIN),
            ("application/x-protobuf;version=2, application/x-protobuf", PADDED),
            ("application/json, application/x-protobuf", Form::Json),
            ("application/x-protobuf, application/json", PLAIN),
            ("application/json;q=0.5, application/x-protobuf;q=0.9", PLAIN),
            ("text/html, application/x-protobuf;q=0.1", PLAIN),
            ("*/*, application/x-protobuf", PLAIN),
            ("*/*, application/x-protobuf;q=0.9", Form::Json),
            ("*/*, application/json;q=0.1", FULL),
            ("application/x-protobuf;q=0", Form::Json),
            ("application/x-protobuf;q=NaN", Form::Json),
            ("application/x-protobuf;q=-3", Form::Json),
            (";;=,q=,;version", Form::Json),
        ] {
            let headers: HeaderMap = [(ACCEPT, accept.parse().expect("a header"))].into_iter().collect();
            assert_eq!(Form::negotiate(&headers, Form::offered(false)), given, "{accept:?}");
        }
        assert_eq!(Form::negotiate(&HeaderMap::new(), Form::offered(false)), Form::Json);
        // Several headers count as one.
        let both =
            ["text/html", "application/x-protobuf;q=0.3"].map(|v| (ACCEPT, v.parse().expect("a header")));
        let mut headers = HeaderMap::new();
        for (name, value) in both {
            headers.append(name, value);
        }
        assert_eq!(Form::negotiate(&headers, Form::offered(false)), PLAIN);
    }

    /// Who asked for trusted poses only gets no form that could not leave one out.
    #[test]
    fn a_form_that_cannot_withhold_is_not_given_where_that_was_asked() {
        for (accept, given) in [
            ("application/x-protobuf", Form::Json),
            ("application/x-protobuf;version=2", Form::Json),
            ("application/x-protobuf;version=3;q=0.1, application/x-protobuf;version=2", FULL),
        ] {
            let headers: HeaderMap = [(ACCEPT, accept.parse().expect("a header"))].into_iter().collect();
            assert_eq!(Form::negotiate(&headers, Form::offered(true)), given, "{accept}");
        }
    }
}
