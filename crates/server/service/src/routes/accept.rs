//! Which form of answer a client gets: `Accept` (RFC 9110, 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

/// A form of answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    Json,
    Protobuf,
}

impl Form {
    /// All forms, the one that is given when the client has no wish first.
    const ALL: [Self; 2] = [Self::Json, Self::Protobuf];

    pub(super) const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Protobuf => "application/x-protobuf",
        }
    }

    /// The form the client likes best: of the greatest weight, then as exactly named as possible, then the first it names,
    /// then the first of ours.
    ///
    /// A client that takes none of our forms gets JSON, which the standard allows.
    pub(super) fn negotiate(headers: &HeaderMap) -> Self {
        let ranges = ranges(headers);
        let mut best: Option<(Wish, Self)> = None;
        for form in Self::ALL {
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
    let mut parameters = parts.filter_map(|part| part.split_once('='));
    // Our types have no parameters; what a client adds to them is no reason not to give it the type.
    let weight = parameters.find(|(key, _)| key.trim().eq_ignore_ascii_case("q"));
    Range { name, thousandths: weight.map_or(1000, |(_, value)| thousandths(value.trim())) }
}

/// The most exact range that a form falls into decides, the first of equals; `None` when it falls into none.
fn wish(ranges: &[Range], form: Form) -> Option<Wish> {
    let exactness = |range: &Range| match range.name.as_str() {
        "*/*" => Some(0),
        "application/*" => Some(1),
        other if other == form.content_type() => Some(2),
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

    #[test]
    fn the_best_form_that_can_be_given_is_given() {
        // Asked for, answered.
        for (accept, given) in [
            ("", Form::Json),
            ("*/*", Form::Json),
            ("application/*", Form::Json),
            ("text/html", Form::Json),
            ("text/html, */*;q=0.1", Form::Json),
            ("application/x-protobuf", Form::Protobuf),
            ("Application/X-Protobuf", Form::Protobuf),
            ("application/x-protobuf; charset=\"x\"", Form::Protobuf),
            ("application/json, application/x-protobuf", Form::Json),
            ("application/x-protobuf, application/json", Form::Protobuf),
            ("application/json;q=0.5, application/x-protobuf;q=0.9", Form::Protobuf),
            ("text/html, application/x-protobuf;q=0.1", Form::Protobuf),
            ("*/*, application/x-protobuf", Form::Protobuf),
            ("*/*, application/x-protobuf;q=0.9", Form::Json),
            ("*/*, application/json;q=0.1", Form::Protobuf),
            ("application/x-protobuf;q=0", Form::Json),
            ("application/x-protobuf;q=NaN", Form::Json),
            ("application/x-protobuf;q=-3", Form::Json),
            (";;=,q=,;charset", Form::Json),
        ] {
            let headers: HeaderMap = [(ACCEPT, accept.parse().expect("a header"))].into_iter().collect();
            assert_eq!(Form::negotiate(&headers), given, "{accept:?}");
        }
        assert_eq!(Form::negotiate(&HeaderMap::new()), Form::Json);
        // Several headers count as one.
        let both =
            ["text/html", "application/x-protobuf;q=0.3"].map(|v| (ACCEPT, v.parse().expect("a header")));
        let mut headers = HeaderMap::new();
        for (name, value) in both {
            headers.append(name, value);
        }
        assert_eq!(Form::negotiate(&headers), Form::Protobuf);
    }
}
