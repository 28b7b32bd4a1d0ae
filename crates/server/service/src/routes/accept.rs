//! Content negotiation: the `Accept` header (RFC 9110, 12.5.1).

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

/// Format of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AnswerFormat {
    Json,
    Protobuf,
}

impl AnswerFormat {
    /// All formats; the first is the default.
    const ALL: [Self; 2] = [Self::Json, Self::Protobuf];

    pub(super) const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Protobuf => "application/x-protobuf",
        }
    }

    /// The format that the client prefers: the greatest weight, then the most specific range, then the first in the
    /// header, then our order.
    ///
    /// A client that accepts none of our formats gets JSON, which RFC 9110 allows.
    pub(super) fn negotiate(headers: &HeaderMap) -> Self {
        let ranges = ranges(headers);
        let mut best: Option<(Preference, Self)> = None;
        for format in Self::ALL {
            let Some(preference) =
                preference(&ranges, format).filter(|preference| preference.thousandths > 0)
            else {
                continue;
            };
            if best.is_none_or(|(other, _)| preference.is_stronger_than(other)) {
                best = Some((preference, format));
            }
        }
        best.map_or(Self::Json, |(_, format)| format)
    }
}

/// A media range and its weight.
struct Range {
    name: String,
    thousandths: u32,
}

/// Preference of the client for a format.
#[derive(Debug, Clone, Copy)]
struct Preference {
    thousandths: u32,
    specificity: u8,
    index: usize,
}

impl Preference {
    fn is_stronger_than(self, other: Self) -> bool {
        let key = |preference: Self| {
            (preference.thousandths, preference.specificity, std::cmp::Reverse(preference.index))
        };
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
    // Our media types have no parameters; parameters of the client are ignored.
    let weight = parameters.find(|(key, _)| key.trim().eq_ignore_ascii_case("q"));
    Range { name, thousandths: weight.map_or(1000, |(_, value)| thousandths(value.trim())) }
}

/// The most specific matching range, the first of equals; `None` if no range matches.
fn preference(ranges: &[Range], format: AnswerFormat) -> Option<Preference> {
    let specificity = |range: &Range| match range.name.as_str() {
        "*/*" => Some(0),
        "application/*" => Some(1),
        other if other == format.content_type() => Some(2),
        _ => None,
    };
    let mut best: Option<Preference> = None;
    for (index, range) in ranges.iter().enumerate() {
        let Some(specificity) = specificity(range) else { continue };
        if best.is_none_or(|preference| specificity > preference.specificity) {
            best = Some(Preference { thousandths: range.thousandths, specificity, index });
        }
    }
    best
}

/// A weight between 0 and 1, in thousandths; an invalid weight counts as 0.
fn thousandths(text: &str) -> u32 {
    text.parse::<f32>().ok().filter(|q| (0.0..=1.0).contains(q)).map_or(0, |q| (q * 1000.0).round() as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preferred_available_format_is_chosen() {
        // Header, chosen format.
        for (accept, given) in [
            ("", AnswerFormat::Json),
            ("*/*", AnswerFormat::Json),
            ("application/*", AnswerFormat::Json),
            ("text/html", AnswerFormat::Json),
            ("text/html, */*;q=0.1", AnswerFormat::Json),
            ("application/x-protobuf", AnswerFormat::Protobuf),
            ("Application/X-Protobuf", AnswerFormat::Protobuf),
            ("application/x-protobuf; charset=\"x\"", AnswerFormat::Protobuf),
            ("application/json, application/x-protobuf", AnswerFormat::Json),
            ("application/x-protobuf, application/json", AnswerFormat::Protobuf),
            ("application/json;q=0.5, application/x-protobuf;q=0.9", AnswerFormat::Protobuf),
            ("text/html, application/x-protobuf;q=0.1", AnswerFormat::Protobuf),
            ("*/*, application/x-protobuf", AnswerFormat::Protobuf),
            ("*/*, application/x-protobuf;q=0.9", AnswerFormat::Json),
            ("*/*, application/json;q=0.1", AnswerFormat::Protobuf),
            ("application/x-protobuf;q=0", AnswerFormat::Json),
            ("application/x-protobuf;q=NaN", AnswerFormat::Json),
            ("application/x-protobuf;q=-3", AnswerFormat::Json),
            (";;=,q=,;charset", AnswerFormat::Json),
        ] {
            let headers: HeaderMap = [(ACCEPT, accept.parse().expect("a header"))].into_iter().collect();
            assert_eq!(AnswerFormat::negotiate(&headers), given, "{accept:?}");
        }
        assert_eq!(AnswerFormat::negotiate(&HeaderMap::new()), AnswerFormat::Json);
        // Repeated headers count as one.
        let both =
            ["text/html", "application/x-protobuf;q=0.3"].map(|v| (ACCEPT, v.parse().expect("a header")));
        let mut headers = HeaderMap::new();
        for (name, value) in both {
            headers.append(name, value);
        }
        assert_eq!(AnswerFormat::negotiate(&headers), AnswerFormat::Protobuf);
    }
}
