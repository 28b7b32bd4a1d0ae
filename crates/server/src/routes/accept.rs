//! Which form of answer a client wants.

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

/// A form of answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    Json,
    Protobuf,
    GeoPose,
}

impl Form {
    const ALL: [Self; 3] = [Self::Json, Self::Protobuf, Self::GeoPose];

    pub(super) const fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Protobuf => "application/x-protobuf",
            Self::GeoPose => "application/geopose+json",
        }
    }

    fn from_media_type(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|form| form.media_type().eq_ignore_ascii_case(name))
    }

    /// The form with the greatest weight, the first of equals. JSON when none of ours is asked for: a client that
    /// sends `*/*`, or nothing, can read that.
    pub(super) fn asked_for(headers: &HeaderMap) -> Self {
        let mut best = (0, Self::Json);
        for value in headers.get_all(ACCEPT) {
            for range in value.to_str().unwrap_or_default().split(',') {
                let mut parts = range.split(';').map(str::trim);
                let Some(form) = parts.next().and_then(Self::from_media_type) else { continue };
                let weight = parts.find_map(|p| p.strip_prefix("q=")).map_or(1000, thousandths);
                if weight > best.0 {
                    best = (weight, form);
                }
            }
        }
        best.1
    }
}

/// A weight between 0 and 1 as HTTP writes it, in thousandths; nonsense counts as no wish.
fn thousandths(text: &str) -> u32 {
    text.parse::<f32>().ok().filter(|q| (0.0..=1.0).contains(q)).map_or(0, |q| (q * 1000.0).round() as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_greatest_weight_wins() {
        for (accept, form) in [
            ("", Form::Json),
            ("*/*", Form::Json),
            ("text/html", Form::Json),
            ("application/x-protobuf", Form::Protobuf),
            ("Application/X-Protobuf", Form::Protobuf),
            ("application/json, application/x-protobuf", Form::Json),
            ("application/json;q=0.5, application/x-protobuf;q=0.9", Form::Protobuf),
            ("text/html, application/x-protobuf;q=0.1", Form::Protobuf),
            ("application/geopose+json, application/json;q=0.5", Form::GeoPose),
            ("application/x-protobuf;q=0", Form::Json),
            ("application/x-protobuf;q=NaN", Form::Json),
            ("application/x-protobuf;q=-3", Form::Json),
        ] {
            let headers = [(ACCEPT, accept.parse().expect("a header"))].into_iter().collect();
            assert_eq!(Form::asked_for(&headers), form, "{accept:?}");
        }
        assert_eq!(Form::asked_for(&HeaderMap::new()), Form::Json);
    }
}
